"""Illumination from an object of known shape."""
