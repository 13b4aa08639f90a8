"""Interreflection between the faces of a voxel model."""
