"""Everything on the sphere: frame, grids, environment maps, harmonics, rotations, wavelets."""
