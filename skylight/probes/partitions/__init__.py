"""The spherical-partitions probe (thesis, chapter 4): designed, printed, captured, relit."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
