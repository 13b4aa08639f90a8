"""The voxel probe: printing, capture, rendering."""
