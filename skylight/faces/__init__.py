"""Faces: photograph to observation by landmarks, head model, fit, skin and segmentation."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
