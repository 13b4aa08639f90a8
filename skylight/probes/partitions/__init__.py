"""Shading probes whose walls partition the sphere into cells (thesis, chapter 4)."""
