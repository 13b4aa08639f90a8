"""Scores of estimated against known illumination."""
