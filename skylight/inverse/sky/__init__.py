"""Illumination by a sky over a Lambertian ground: a coarse-to-fine solver."""
