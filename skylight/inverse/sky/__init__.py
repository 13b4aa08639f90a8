"""Illumination by a sky over a Lambertian ground: coarse to fine, and smoothed over films."""
