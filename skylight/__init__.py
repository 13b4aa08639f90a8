"""Inverse lighting and relighting: the public names, each imported when it is first used."""

from importlib import import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skylight.app.estimate.photos import estimate, estimate_photo
    from skylight.app.estimate.types import PhotoEstimate
    from skylight.csc.coder import SphericalSparseCoder
    from skylight.csc.dictionary import FilterBank
    from skylight.csc.sampling import CodeSampler
    from skylight.errors import SkylightError
    from skylight.imaging.photo import Photo, read_photo
    from skylight.imaging.taken import Taken
    from skylight.inverse.estimate import estimate_each, estimate_light
    from skylight.inverse.result import Estimate
    from skylight.io.files import read_environment_map, write_environment_map
    from skylight.models.autoencoder import AutoencoderLight
    from skylight.models.harmonic import HarmonicLight
    from skylight.models.known_ground import KnownGround
    from skylight.models.lamps import LampsLight
    from skylight.models.sunsky import SunSky
    from skylight.probes.partitions.probe import PartitionProbe
    from skylight.probes.voxel.probe import VoxelProbe
    from skylight.sphere.envmap import EnvironmentMap
    from skylight.sphere.grid import DirectionGrid
    from skylight.transport.diffuse import DiffuseTransport
    from skylight.transport.matrix import TransportMatrix

__version__ = _version("skylight")

# Lazy, because torch takes seconds to import and relighting does without it.
_HOME = {
    "AutoencoderLight": "skylight.models.autoencoder",
    "CodeSampler": "skylight.csc.sampling",
    "DiffuseTransport": "skylight.transport.diffuse",
    "DirectionGrid": "skylight.sphere.grid",
    "EnvironmentMap": "skylight.sphere.envmap",
    "Estimate": "skylight.inverse.result",
    "FilterBank": "skylight.csc.dictionary",
    "HarmonicLight": "skylight.models.harmonic",
    "KnownGround": "skylight.models.known_ground",
    "LampsLight": "skylight.models.lamps",
    "PartitionProbe": "skylight.probes.partitions.probe",
    "Photo": "skylight.imaging.photo",
    "PhotoEstimate": "skylight.app.estimate.types",
    "SkylightError": "skylight.errors",
    "SphericalSparseCoder": "skylight.csc.coder",
    "SunSky": "skylight.models.sunsky",
    "Taken": "skylight.imaging.taken",
    "TransportMatrix": "skylight.transport.matrix",
    "VoxelProbe": "skylight.probes.voxel.probe",
    "estimate": "skylight.app.estimate.photos",
    "estimate_each": "skylight.inverse.estimate",
    "estimate_light": "skylight.inverse.estimate",
    "estimate_photo": "skylight.app.estimate.photos",
    "read_environment_map": "skylight.io.files",
    "read_photo": "skylight.imaging.photo",
    "write_environment_map": "skylight.io.files",
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
