"""Illumination by lamps in smooth ambient light, on the whole sphere."""
