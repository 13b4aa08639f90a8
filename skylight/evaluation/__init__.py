"""The thesis' tables and others: what is measured, how it is run and written."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
