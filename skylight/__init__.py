"""Inverse lighting and relighting: the public names, each imported when it is first used."""

from importlib.metadata import version

import lazy_loader

# torch takes seconds to import, and relighting does without it
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = version("skylight-lighting")
