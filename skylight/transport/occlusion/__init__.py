"""Occlusion by PyTorch: a bounding volume hierarchy, and rays through it on any device."""
