"""Faces found in pictures, and the points of each."""
