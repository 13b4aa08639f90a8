"""Spherical harmonic illumination: robust and non-negative least squares."""
