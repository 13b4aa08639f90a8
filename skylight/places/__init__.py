"""Places whose light is known: outdoors, rooms, studios, streets at night, shops and cars."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
