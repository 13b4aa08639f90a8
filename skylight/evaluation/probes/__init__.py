"""Evaluations of the shading probes."""
