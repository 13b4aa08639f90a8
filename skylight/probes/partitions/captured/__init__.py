"""Shading of the partitions probe from photographs."""
