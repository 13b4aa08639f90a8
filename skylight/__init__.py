"""Inverse lighting and relighting: the public names, each imported when it is first used."""

from importlib import import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skylight.csc._coder import SphericalSparseCoder
    from skylight.csc._dictionary import FilterBank
    from skylight.csc._sampling import CodeSampler
    from skylight.errors import SkylightError
    from skylight.estimation._photos import estimate, estimate_photo
    from skylight.estimation._summary import PhotoEstimate
    from skylight.imaging._photo import Photo, read_photo
    from skylight.imaging._taken import Taken
    from skylight.inverse._estimate import estimate_each, estimate_light
    from skylight.inverse._result import Estimate
    from skylight.io._files import read_environment_map, write_environment_map
    from skylight.models._ground import KnownGround
    from skylight.models._harmonic import HarmonicLight
    from skylight.models._lamps import LampsLight
    from skylight.models.autoencoder import AutoencoderLight
    from skylight.models.sunsky import SunSky
    from skylight.probes.partitions._probe import PartitionProbe
    from skylight.probes.voxel._probe import VoxelProbe
    from skylight.sphere._envmap import EnvironmentMap
    from skylight.sphere._frame import DirectionGrid
    from skylight.transport._matrix import TransportMatrix
    from skylight.transport._reflection import DiffuseTransport

__version__ = _version("skylight-lighting")

# Lazy, because torch takes seconds to import and relighting does without it.
_HOME = {
    "AutoencoderLight": "skylight.models.autoencoder",
    "CodeSampler": "skylight.csc._sampling",
    "DiffuseTransport": "skylight.transport._reflection",
    "DirectionGrid": "skylight.sphere._frame",
    "EnvironmentMap": "skylight.sphere._envmap",
    "Estimate": "skylight.inverse._result",
    "FilterBank": "skylight.csc._dictionary",
    "HarmonicLight": "skylight.models._harmonic",
    "KnownGround": "skylight.models._ground",
    "LampsLight": "skylight.models._lamps",
    "PartitionProbe": "skylight.probes.partitions._probe",
    "Photo": "skylight.imaging._photo",
    "PhotoEstimate": "skylight.estimation._summary",
    "SkylightError": "skylight.errors",
    "SphericalSparseCoder": "skylight.csc._coder",
    "SunSky": "skylight.models.sunsky",
    "Taken": "skylight.imaging._taken",
    "TransportMatrix": "skylight.transport._matrix",
    "VoxelProbe": "skylight.probes.voxel._probe",
    "estimate": "skylight.estimation._photos",
    "estimate_each": "skylight.inverse._estimate",
    "estimate_light": "skylight.inverse._estimate",
    "estimate_photo": "skylight.estimation._photos",
    "read_environment_map": "skylight.io._files",
    "read_photo": "skylight.imaging._photo",
    "write_environment_map": "skylight.io._files",
}

__all__ = [
    "AutoencoderLight",
    "CodeSampler",
    "DiffuseTransport",
    "DirectionGrid",
    "EnvironmentMap",
    "Estimate",
    "FilterBank",
    "HarmonicLight",
    "KnownGround",
    "LampsLight",
    "PartitionProbe",
    "Photo",
    "PhotoEstimate",
    "SkylightError",
    "SphericalSparseCoder",
    "SunSky",
    "Taken",
    "TransportMatrix",
    "VoxelProbe",
    "__version__",
    "estimate",
    "estimate_each",
    "estimate_light",
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
