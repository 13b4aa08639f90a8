"""Names that the command line takes as choices; a comment tells the module that each belongs to.

They stand by themselves so that parsing a command imports no torch.
"""

import logging
from dataclasses import dataclass
from typing import Literal, get_args

from skylight.errors import InputError

# What the map of an estimate shows beside its light: skylight.estimation._detail
DetailName = Literal["none", "photo", "mirrored"]
DEFAULT_DETAIL: DetailName = "none"

# How a sphere is drawn on a plane: skylight.sphere._projections
Projection = Literal["latlong", "cube", "octahedral", "angular", "mirrorball"]
# How the six faces of a cube map lie in a picture or in files: skylight.sphere._cube_layouts
CubeLayout = Literal["cube-vertical", "cube-row", "cube-column", "cube-faces"]
MapLayout = Literal[Projection, CubeLayout]
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

# Where a portrait's key light stands: skylight.portrait._keys
KeyName = Literal["left", "right", "top", "rim", "front"]

# Light models, on the command line and in results: skylight.models
LightName = Literal["sphere", "autoencoder", "sunsky", "lamps", "auto", "sh9", "sh25"]
DEFAULT_LIGHT: LightName = "sphere"
DEFAULT_SKY: LightName = "autoencoder"  # for what only skies have: light_at
LIGHT_NAMES: tuple[LightName, ...] = get_args(LightName)
# Skies above a ground ("auto" may choose one)
SKY_LIGHTS: tuple[LightName, ...] = ("autoencoder", "sunsky", "auto")

# Where a photograph was taken, for who knows, and the light models that are possible there. A
# flash is a lamp on the camera.
Place = Literal["auto", "outdoors", "indoors", "flash"]
PLACES: tuple[Place, ...] = get_args(Place)
_LIGHTS_AT: dict[str, tuple[LightName, ...]] = {
    "auto": LIGHT_NAMES,
    "outdoors": ("sphere", "autoencoder", "sunsky", "sh9", "sh25"),
    "indoors": ("sphere", "lamps", "sh9", "sh25"),
    "flash": ("sphere", "lamps"),
}


def light_at(light: LightName, place: str, of_skies: str = "") -> LightName:
    """The light model for a place, and for what is asked ``of_skies`` (in words).

    At a known place "auto" is the default. The default gives way to :data:`DEFAULT_SKY` where
    something is asked that only skies have, which is logged.

    Raises
    ------
    InputError
        An unknown place, or a light that was chosen and is not there.
    """
    if place not in PLACES:
        raise InputError(f"unknown place {place!r}: choose one of {', '.join(PLACES)}")
    if light == "auto" and place != "auto":
        light = DEFAULT_LIGHT
    lights = _LIGHTS_AT[place]
    if light not in lights:
        raise InputError(
            f"{light} is no light for the place {place}: leave one of them out, or choose "
            f"{' or '.join(lights)}"
        )
    if not of_skies or light != DEFAULT_LIGHT or DEFAULT_SKY not in lights:
        return light
    logging.getLogger(__name__).warning(
        "skylight: %s: only skies have that, so the light is %s, not the default %s",
        of_skies,
        DEFAULT_SKY,
        DEFAULT_LIGHT,
    )
    return DEFAULT_SKY


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


def is_trained(light: LightName, *, of_places: bool) -> bool:
    """Whether a trained model has anything for this light: skies a network and priors."""
    return light in (("sphere",) if of_places else SKY_LIGHTS)


def check_is_trained(light: LightName, *, of_places: bool) -> None:
    """:class:`InputError` for a light that does not take this model."""
    if is_trained(light, of_places=of_places):
        return
    if not is_trained(light, of_places=not of_places):
        raise InputError(f"{light} has no trained model: leave --model out")
    kind, lights = ("places", ("sphere",)) if of_places else ("skies", SKY_LIGHTS)
    raise InputError(
        f"--model holds {kind}, for --light {' or '.join(lights)}, not {light}: leave it out, or "
        "choose one of these"
    )
