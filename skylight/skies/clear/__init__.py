"""The clear sky: its spectrum, its scattering, and what of it reaches the observer."""
