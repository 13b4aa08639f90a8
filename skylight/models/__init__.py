"""Light models: parameters to radiance, with their bounds and priors."""
