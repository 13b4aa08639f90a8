"""Shading of the voxel probe from photographs."""
