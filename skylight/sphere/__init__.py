"""The unit sphere: frames, grids, maps, harmonics, rotations, wavelets."""
