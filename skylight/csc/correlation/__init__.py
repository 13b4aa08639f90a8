"""Rotational correlation of filters with signals, on SO(3) and on the sphere."""
