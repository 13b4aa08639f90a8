"""HDR light probes from exposures of mirror balls and of 360-degree cameras."""
