"""What inverse lighting answers: a light, and what it does to each face."""

from dataclasses import dataclass
from typing import Literal

from jaxtyping import Bool, Float
from torch import Tensor

from skylight.imaging._edits import UNEDITED, Edit
from skylight.inverse._posterior import SunPosterior
from skylight.sphere._envmap import EnvironmentMap, luminance

Status = Literal["converged", "iteration limit", "recovered from a non-finite step"]
Scene = Literal[
    "open sky, sun",
    "open sky, overcast",
    "no open sky, even light",
    "no open sky, flash",
    "no open sky, one lamp",
    "no open sky, two lamps",
    "no open sky, three lamps",
]
UNEXPLAINED = 0.25  # a face whose residual is larger cannot be trusted


@dataclass(frozen=True, kw_only=True)
class FaceLight:
    """What a face does with light: ``white_balance * (pixel_albedo * T l + specular_scale * G l)``.

    The picture shows that edited, by ``edit`` (:mod:`skylight.imaging._edits`), whose pivot is the
    mean luminance of its photograph's faces. l is the light exposed, and ``pixel_albedo`` (m,3)
    varies about ``albedo``, its geometric mean over the skin of the face, with melanin and blood;
    it is ``albedo`` for what is no face.

    ``photo`` is the number of its photograph among all that were given, from 0, and ``exposure``
    that photograph's, as are the gains ``white_balance``, of product 1, by which it shows each
    channel too bright; ``rendered`` (m,3) its observation's pixels, in the photograph's radiance
    units; ``residual`` their mean deviation in luminance, relative to the face's mean.
    ``specular_scale`` is 0 where a model leaves surface reflection out. ``turns`` (j,) is what
    normals are turned by along the observation's ``normal_modes``, with which T l is 0 at least;
    None where they are trusted.
    """

    photo: int
    exposure: float
    white_balance: Float[Tensor, "3"]
    albedo: Float[Tensor, "3"]
    pixel_albedo: Float[Tensor, "m 3"]
    specular_scale: float
    rendered: Float[Tensor, "m 3"]
    residual: float
    turns: Float[Tensor, " j"] | None = None
    edit: Edit = UNEDITED


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A lamp that was found: unit ``direction``, and ``irradiance`` of a surface that faces it.

    In the environment map's units. Its light comes from about ``spread_rad`` per axis about the
    direction (a von Mises-Fisher lobe).
    """

    direction: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]
    spread_rad: float


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Why an estimate is of its light model, where several competed.

    ``scene`` in words, ``probability`` that the model is the right one of those, and the
    ``log_evidence`` of each (nats). ``exposure_log_odds`` are those of an open sky that the
    picture's exposure tells, 0 where it is unknown.
    """

    scene: Scene
    probability: float
    log_evidence: dict[str, float]
    exposure_log_odds: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The light of a picture, in its camera's frame and its own radiance units.

    ``environment`` is a full map, of 128 x 256 pixels where it is a sky, else of 64 x 128;
    ``faces`` what was lit by it, one or more, in the order in which they were given; ``terms``
    the parts of the objective (nats) at the end;
    ``params`` those of the light model. ``status`` is "converged" where the optimisation ended
    at a minimum, else how it ended (``stats["nonfinite"]`` counts steps taken back in either
    case), and ``advice`` says what to do where the result should not be trusted (empty where
    it can). ``posterior`` says how sure the sun, exposure and albedo are. ``lamps`` are those of a
    light model that has lamps, the strongest first; ``sun_direction`` is then where that stands,
    or where the light is brightest if there is none.
    ``log_evidence`` (nats) is how likely the faces are under the light model, to be compared with
    that of others for the same faces; None where it was not asked for. ``choice`` says what
    competed, where light was "auto".

    Of several photographs the map has the first used one's units: a face of another sees it times
    the ratio of the two exposures. ``exposure``, ``white_balance``, ``albedo`` and ``rendered`` are
    the first face's, as are ``saturation`` and ``contrast`` of its photograph's edit. The map has
    the light's own colours: the picture is ``white_balance`` times what it shades, edited.
    """

    light: str
    environment: EnvironmentMap
    params: Float[Tensor, " p"]
    ground_albedo: Float[Tensor, "3"]
    sun_direction: Float[Tensor, "3"]
    posterior: SunPosterior
    faces: tuple[FaceLight, ...]
    terms: dict[str, float]
    status: Status
    advice: tuple[str, ...]
    stats: dict[str, float | int]
    lamps: tuple[Lamp, ...] = ()
    log_evidence: float | None = None
    choice: Choice | None = None

    @property
    def exposure(self) -> float:
        return self.faces[0].exposure

    @property
    def white_balance(self) -> Float[Tensor, "3"]:
        return self.faces[0].white_balance

    @property
    def saturation(self) -> float:
        return self.faces[0].edit.saturation

    @property
    def contrast(self) -> float:
        return self.faces[0].edit.contrast

    @property
    def albedo(self) -> Float[Tensor, "3"]:
        return self.faces[0].albedo

    @property
    def rendered(self) -> Float[Tensor, "m 3"]:
        return self.faces[0].rendered


def residual(
    rendered: Float[Tensor, "m 3"],
    seen: Float[Tensor, "m 3"],
    clipped: Bool[Tensor, " m"] | None = None,
) -> float:
    """Mean ``|rendered - seen|`` in luminance, relative to the mean luminance seen.

    Where ``clipped``, what was seen is a lower bound: both means leave out the bounds that are
    kept. The residual is 0 where these are all there is.
    """
    true = luminance(seen)
    deviation = luminance(rendered) - true
    if clipped is not None:
        counted = ~clipped | (deviation < 0)
        if not bool(counted.any()):
            return 0.0
        deviation, true = deviation[counted], true[counted]
    return float(deviation.abs().mean() / true.mean())


def advice(faces: tuple[FaceLight, ...]) -> tuple[str, ...]:
    """What the residuals tell about trust."""
    given = []
    for number, face in enumerate(faces, start=1):
        name = "face" if len(faces) == 1 else f"face {number} of {len(faces)}"
        if face.residual > UNEXPLAINED:
            given.append(
                f"the re-rendered {name} is off by {100 * face.residual:.0f} % on average: the "
                "light is unreliable; check the mesh overlay, or use a picture with less hair, "
                "glasses or shine on the skin"
            )
    return tuple(given)
