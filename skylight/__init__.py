"""Light from pictures of faces: the public names, each imported when it is first used."""

from importlib import import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skylight.app.estimate import estimate
    from skylight.errors import SkylightError
    from skylight.imaging.files import read_environment_map, write_environment_map
    from skylight.imaging.photo import Photo, read_photo
    from skylight.inverse.photo import PhotoEstimate, estimate_photo
    from skylight.inverse.solve import Estimate
    from skylight.sphere.envmap import EnvironmentMap
    from skylight.sphere.grid import DirectionGrid

__version__ = _version("skylight")

# Lazy, because torch takes seconds to import and relighting does without it.
_HOME = {
    "DirectionGrid": "skylight.sphere.grid",
    "EnvironmentMap": "skylight.sphere.envmap",
    "Estimate": "skylight.inverse.solve",
    "Photo": "skylight.imaging.photo",
    "PhotoEstimate": "skylight.inverse.photo",
    "SkylightError": "skylight.errors",
    "estimate": "skylight.app.estimate",
    "estimate_photo": "skylight.inverse.photo",
    "read_environment_map": "skylight.imaging.files",
    "read_photo": "skylight.imaging.photo",
    "write_environment_map": "skylight.imaging.files",
}

__all__ = [
    "DirectionGrid",
    "EnvironmentMap",
    "Estimate",
    "Photo",
    "PhotoEstimate",
    "SkylightError",
    "__version__",
    "estimate",
    "estimate_photo",
    "read_environment_map",
    "read_photo",
    "write_environment_map",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'skylight' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
