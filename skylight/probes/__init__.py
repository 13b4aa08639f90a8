"""Light probes and shading probes: printed, captured, and used to light virtual scenes."""
