"""What inverse lighting answers: a light, and what it does to each face."""

import math
from dataclasses import dataclass, field
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.imaging._edits import UNEDITED, Edit
from skylight.inverse._posterior import SunPosterior
from skylight.inverse._verdict import Spreads, Verdict, verdict_of
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._observation import Observation

Status = Literal["converged", "iteration limit", "recovered from a non-finite step"]
MAP_ROWS = 256  # of an estimate's map: of the whole sphere
SUN_SPREAD_RAD = float(SUN_RADIUS_RAD) / 2  # per axis, of an even disc of 0.53 degrees
# A face whose residual or misplaced shading is larger is not explained. Of 34 rendered people under
# simulated skies and places the first is .15 at most, and the second .43 but for two of .53 and
# .55, the main light of one of which is off by 96 degrees; where their pictures are multiplied by
# fields of 45 % or darkened on one side by as much or more, either is as large in four of seven.
UNEXPLAINED, MISPLACED = 0.18, 0.5
TRUSTED = 0.25  # of a background: less hardly counts
FLAT = 0.1  # of the mean: shading that is less is hardly any


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
    units; ``residual`` their mean deviation in luminance, relative to the face's mean, and
    ``misplaced`` the share of the face's :func:`misplaced_shading`.
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
    misplaced: float = 0.0
    turns: Float[Tensor, " j"] | None = None
    edit: Edit = UNEDITED

    @property
    def is_explained(self) -> bool:
        return self.residual <= UNEXPLAINED and self.misplaced <= MISPLACED


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A lamp that was found: unit ``direction``, and ``irradiance`` of a surface that faces it.

    In the environment map's units. Its light comes from about ``spread_rad`` per axis about the
    direction (a von Mises-Fisher lobe); a sun's from :data:`SUN_SPREAD_RAD`.
    """

    direction: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]
    spread_rad: float

    @property
    def is_sun(self) -> bool:
        return self.spread_rad <= SUN_SPREAD_RAD


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Why an estimate is of its light model, where several competed.

    ``probability`` that the model is the right one of those, and the ``log_evidence`` of each
    (nats). ``exposure_log_odds`` are those of an open sky that the picture's exposure tells, 0
    where it is unknown.
    """

    probability: float
    log_evidence: dict[str, float]
    exposure_log_odds: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The light of a picture, in its camera's frame and its own radiance units.

    ``environment`` is a full map of :data:`MAP_ROWS` rows, 256 x 512 pixels; ``faces`` what was
    lit by it, one or more, in the order in which they were given; ``terms`` the parts of the
    objective (nats) at the end;
    ``params`` those of the light model. ``status`` is "converged" where the optimisation ended
    at a minimum, else how it ended (``stats["nonfinite"]`` counts steps taken back in either
    case), and ``advice`` says what to do where the result should not be trusted (empty where
    it can). ``posterior`` says how sure the sun, exposure and albedo are, ``spreads`` level and
    colour of the map, and the :attr:`verdict` all of that in words; ``doubt`` is why the faces may
    be none. ``lamps`` are those of a
    light model that has lamps, the strongest first; ``sun_direction`` is then where that stands,
    or where the light is brightest if there is none.
    ``log_evidence`` (nats) is how likely the faces are under the light model, to be compared with
    that of others for the same faces; None where it was not asked for. ``choice`` says what
    competed, where light was "auto", and ``kinds`` how likely the place is of each kind, where
    light was "sphere".

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
    spreads: Spreads
    faces: tuple[FaceLight, ...]
    terms: dict[str, float]
    status: Status
    advice: tuple[str, ...]
    stats: dict[str, float | int]
    lamps: tuple[Lamp, ...] = ()
    log_evidence: float | None = None
    choice: Choice | None = None
    kinds: dict[str, float] = field(default_factory=dict)
    doubt: str = ""

    @property
    def verdict(self) -> Verdict:
        """How sure direction, brightness and colour of the map are, in words."""
        explained = all(face.is_explained for face in self.faces)
        trusts = [
            trust for name, trust in self.stats.items() if name.startswith("background_trust")
        ]
        return verdict_of(
            self.environment,
            self.sun_direction,
            self.posterior,
            self.spreads,
            doubt=self.doubt or ("" if explained else "the face is not explained"),
            background="unseen" if not trusts else "used" if max(trusts) >= TRUSTED else "doubted",
        )

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


def misplaced_shading(rendered: Float[Tensor, "m 3"], seen: Observation) -> float:
    """How much of a face's shading is where the light does not put it: 0 where none is.

    ``|P (r - y)| / (|P (y - mean)|^2 + (FLAT mean)^2)^(1/2)``, r and y the luminance rendered and
    seen, P the projection on polynomials of degree 3 of a pixel's place, norms weighted means.
    Wrong skin and noise vary from pixel to pixel; what a wrong light leaves is smooth.
    """
    weights = seen.weights.double() if seen.clipped is None else seen.weights * ~seen.clipped
    total = float(weights.sum())
    if total <= 0:
        return 0.0
    root = (weights / total).double().sqrt()
    true = luminance(seen.pixels).double()
    mean = root.square() @ true
    places = seen.places.double() - seen.places.double().mean(0)
    row, column = (places / places.abs().max().clamp(min=1)).unbind(1)
    terms = torch.stack([row**i * column**j for i in range(4) for j in range(4 - i)], 1)
    both = torch.stack([luminance(rendered).double() - true, true - mean], 1) / mean
    columns = root[:, None] * terms
    smooth = columns @ torch.linalg.lstsq(columns, root[:, None] * both, driver="gelsd").solution
    off, shading = smooth.norm(dim=0).tolist()
    return off / math.hypot(shading, FLAT)


def advice(faces: tuple[FaceLight, ...]) -> tuple[str, ...]:
    """What the residuals tell about trust."""
    given = []
    for number, face in enumerate(faces, start=1):
        name = "face" if len(faces) == 1 else f"face {number} of {len(faces)}"
        if face.residual <= UNEXPLAINED and face.misplaced > MISPLACED:
            given.append(
                f"the re-rendered {name} has its light and shade elsewhere: the light is "
                "unreliable; check the mesh overlay, or use a picture without shadows on the face"
            )
        if face.residual > UNEXPLAINED:
            given.append(
                f"the re-rendered {name} is off by {100 * face.residual:.0f} % on average: the "
                "light is unreliable; check the mesh overlay, or use a picture with less hair, "
                "glasses or shine on the skin"
            )
    return tuple(given)
