"""Everything on the unit sphere that knows neither images nor networks."""
