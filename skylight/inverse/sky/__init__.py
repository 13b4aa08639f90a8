"""Illumination by a sky over a Lambertian ground: objective, starts, coarse-to-fine solver."""
