"""Rendered people under known illumination, and captures of real ones."""
