"""Light probes and shading probes: printed, captured, and used to light virtual scenes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
