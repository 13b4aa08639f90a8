"""Style, panels and exposure of all figures."""
