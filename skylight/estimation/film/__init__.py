"""Illumination from films of faces: one person followed, one head, a light that moves smoothly."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
