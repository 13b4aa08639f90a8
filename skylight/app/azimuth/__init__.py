"""The azimuth between light probes and photographs of faces."""
