"""HDR light probes stitched from the photographs of a turning camera."""
