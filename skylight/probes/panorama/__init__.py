"""HDR light probes stitched from the shots of a camera that turns about its lens."""
