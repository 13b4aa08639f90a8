"""The camera of shading probes: calibration, pose and response."""
