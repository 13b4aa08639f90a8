"""What stands around a viewer: terrain, trees, buildings and streets, drawn below a sky."""
