"""Names that the command line takes as choices; a comment tells the module that each belongs to.

They stand by themselves so that parsing a command imports no torch.
"""

from dataclasses import dataclass
from typing import Literal, get_args

from skylight.errors import InputError

# What the map of an estimate shows beside its light: skylight.estimation._detail
DetailName = Literal["none", "photo", "mirrored"]
DEFAULT_DETAIL: DetailName = "none"

# How a sphere is drawn on a plane: skylight.sphere._projections
Projection = Literal["latlong", "cube", "octahedral", "angular", "mirrorball"]
# Where the columns of a lat-long map look: skylight.sphere._frame
Convention = Literal["skylight", "openexr", "mitsuba", "threejs", "blender", "unity"]


@dataclass(frozen=True, kw_only=True)
class MapReading:
    """How the files of maps are read: the options of :func:`skylight.io.read_environment_map`."""

    layer: str | None = None
    """Layer of the .exr files that have several, as ViewLayer.Combined."""
    repair: bool = False
    """Replace infinite and NaN pixels, and small negative values, if they are few."""


PLAIN_READING = MapReading()

# Signs, order and scale of nine spherical harmonics: skylight.sphere._harmonics
HarmonicConvention = Literal["skylight", "threejs", "arcore", "arkit", "gltf"]

# Dictionaries that come with the package: skylight.csc._dictionary
BuiltinName = Literal["iso", "ani", "vmf", "box"]
# Weights of either sign with a weak L1 norm, none below 0, or plain least squares:
# skylight.csc._greedy
Sign = Literal["l1", "nonnegative", "free"]

# By what the faces of a photograph, their landmarks and heads are chosen: skylight.faces
LandmarkerName = Literal["mediapipe", "dlib"]
WhichFaces = int | Literal["all"]  # counted from 1, the largest
HeadName = Literal["fitted", "deformed"]

# Lights that known objects are explained by, sparse codes of a dictionary, spherical harmonics, or
# lamps in ambient light: skylight.object._problem
ObjectLightName = Literal["ani", "iso", "vmf", "sh9", "sh25", "sh49", "lamps"]
OBJECT_LIGHTS: tuple[ObjectLightName, ...] = get_args(ObjectLightName)

# Paper that marker boards are printed on: skylight.probes.cameras._board
Page = Literal["A4", "A3", "letter"]
# What is photographed to merge a light probe: skylight.probes.mirror_balls._merged
MergedFrom = Literal["ball", "360"]

# Programs for which light is exported: skylight.maps._export
LightTarget = Literal["threejs", "sh", "ar", "gltf", "usd", "mitsuba", "blender"]

# Light models, on the command line and in results: skylight.models
LightName = Literal["sphere", "auto", "autoencoder", "sunsky", "lamps", "sh9", "sh25"]
# Not "auto": without exposures that takes half of the photographs under an open sky for lamps
DEFAULT_LIGHT: LightName = "autoencoder"
LIGHT_NAMES: tuple[LightName, ...] = get_args(LightName)
# Skies above a ground ("auto" may choose one)
SKY_LIGHTS: tuple[LightName, ...] = ("auto", "autoencoder", "sunsky")

# Where a photograph was taken, for who knows, and the light models that are possible there: the
# first in place of one that was not chosen. A flash is a lamp on the camera.
Place = Literal["auto", "outdoors", "indoors", "flash"]
PLACES: tuple[Place, ...] = get_args(Place)
_LIGHTS_AT: dict[str, tuple[LightName, ...]] = {
    "outdoors": ("autoencoder", "sphere", "sunsky", "sh9", "sh25"),
    "indoors": ("lamps", "sphere", "sh9", "sh25"),
    "flash": ("lamps", "sphere"),
}


def light_at(light: LightName, place: str) -> LightName:
    """The light model for a place; :class:`InputError` for one that was chosen and is not there."""
    if place not in PLACES:
        raise InputError(f"unknown place {place!r}: choose one of {', '.join(PLACES)}")
    if place == "auto" or light in _LIGHTS_AT[place]:
        return light
    if light not in ("auto", DEFAULT_LIGHT):
        raise InputError(
            f"{light} is no light for the place {place}: leave one of them out, or choose "
            f"{' or '.join(_LIGHTS_AT[place])}"
        )
    return _LIGHTS_AT[place][0]


# Of skies: from where a scan finds the sun, or as in the thesis, B.1
SolverName = Literal["scan", "thesis"]
DEFAULT_SOLVER: SolverName = "scan"
SOLVER_NAMES: tuple[SolverName, ...] = get_args(SolverName)


def check_light_name(name: str) -> LightName:
    """``name`` where a light model has it; :class:`InputError` names those there are."""
    if name not in LIGHT_NAMES:
        raise InputError(f"unknown light model {name!r}: choose one of {', '.join(LIGHT_NAMES)}")
    return name  # type: ignore[return-value]


def check_detail_name(name: str) -> DetailName:
    """``name`` where it is a detail of maps; :class:`InputError` names those there are."""
    if name not in get_args(DetailName):
        raise InputError(f"unknown detail {name!r}: choose {', '.join(get_args(DetailName))}")
    return name  # type: ignore[return-value]


def check_solver_name(name: str, light: str) -> SolverName:
    """``name`` where it searches for that light; :class:`InputError` names those that do."""
    if name not in SOLVER_NAMES:
        raise InputError(f"unknown solver {name!r}: choose one of {', '.join(SOLVER_NAMES)}")
    if name != DEFAULT_SOLVER and light != "autoencoder":
        raise InputError(f"the solver {name} is for the light autoencoder, not for {light}")
    return name  # type: ignore[return-value]


def is_trained(light: LightName) -> bool:
    """Whether a light model's folder has anything for this light: a network, or a prior."""
    return light in SKY_LIGHTS


def check_is_trained(light: LightName) -> None:
    """:class:`InputError` for a light that takes no model's folder."""
    if not is_trained(light):
        raise InputError(f"{light} has no trained model: leave --model out")
