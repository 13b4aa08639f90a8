"""The voxel probe as press-fit parts for 3D printing."""
