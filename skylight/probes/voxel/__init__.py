"""The voxel shading probe (thesis, chapter 3): designed, printed, captured, and used to relight."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
