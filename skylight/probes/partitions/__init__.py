"""Shading probes whose walls part the sphere into cells (thesis, chapter 4)."""
