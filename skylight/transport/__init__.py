"""From geometry to how light becomes shading: ray casting, transport matrices, rendering."""
