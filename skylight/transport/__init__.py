"""Geometry to transport matrices: how light from each direction becomes shading."""
