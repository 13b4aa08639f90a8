"""Light models: few parameters in, radiance out; batched and differentiable."""
