"""Meshes lit by the cells of a partitions probe: transfer, rendering, compositing, export."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
