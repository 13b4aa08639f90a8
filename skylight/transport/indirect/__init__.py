"""Light that bounces between surfaces: traced path by path, or as a transport matrix."""
