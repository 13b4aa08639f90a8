"""Parts for 3D printers: files, layout, mounts and checks."""
