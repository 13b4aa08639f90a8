"""Parts for 3D printing: their checks, mounts, files and reports."""
