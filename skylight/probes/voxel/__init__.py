"""The voxel shading probe (thesis, chapter 3)."""
