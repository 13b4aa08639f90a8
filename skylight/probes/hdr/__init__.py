"""HDR probes from photographs: exposures merged, mirror balls unwrapped, two views blended."""
