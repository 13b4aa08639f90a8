"""Convolutional sparse coding on the sphere: light as few turned copies of few filters."""
