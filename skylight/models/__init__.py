"""Light models: differentiable maps from few parameters to radiance, with priors."""
