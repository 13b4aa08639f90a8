"""Convolutional sparse coding on the sphere: maps as sums of few rotated filters."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
