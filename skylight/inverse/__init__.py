"""Inverse lighting: observations, a light model and a prior to an estimate."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
