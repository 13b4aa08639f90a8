"""Linear light merged from exposures, and lat-long maps that tell what of it is known."""
