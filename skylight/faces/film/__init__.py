"""Faces in films: one person followed, one head for all frames."""
