"""The commands of the shading probes."""
