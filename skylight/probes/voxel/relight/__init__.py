"""Voxel models rendered with the probe's lightmap."""
