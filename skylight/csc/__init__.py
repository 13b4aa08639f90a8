"""Convolutional sparse coding on the sphere: maps as sums of few rotated filters."""
