"""The voxel shading probe (thesis, chapter 3): designed, printed, captured, and used to relight."""
