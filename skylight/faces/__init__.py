"""Faces: the head model, finding it in a picture, and the skin it wears."""
