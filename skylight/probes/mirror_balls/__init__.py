"""HDR light probes from photographs of mirror balls."""
