"""Light probes and shading probes: printing, capture and relighting; files to files."""
