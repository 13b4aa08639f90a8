"""Illumination from films of faces: one person followed, one head, a light that moves smoothly."""
