"""Meshes lit by the cells of a partitions probe: transfer, rendering, compositing, export."""
