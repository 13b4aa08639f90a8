"""The partitions probe as solids for 3D printing."""
