"""Faces found in pictures, and the points of each: networks, and how often they look."""
