"""Shading probes: printable objects whose captured shading lights virtual scenes."""
