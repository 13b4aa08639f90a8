"""What an estimate is worth, in words: of its direction, its brightness and its colour.

A :class:`Verdict` begins with a sentence about the map that is written, by
:func:`light_in_words`, so that nothing it says contradicts the picture. Each of the three words is
"sure", "rough" or "unknown", by how far off 90 % of such estimates are at most:

**Direction.** The angle r about the direction found within which the posterior p has 90 %,
``int_{angle <= r} p = 0.9``. It is rough where two thirds lie near it, whatever the rest.

**Brightness, colour.** ``exp(1.645 s)``, with s the standard deviation of the log of the map's mean
luminance, or of the log of its mean red or blue over its mean green, whichever is larger. Of f(x),
x the unknowns of the objective with the curvature H at its minimum, ::

    s^2 = k^2 df/dx^T H^-1 df/dx + e^2.

What a photograph's background shows of the light is in H as the face is. k and e are what models
and heads are wrong by beyond what H knows.

Where the face is not explained, or is no face, all three are unknown.

Constants are of rendered people under simulated skies and places
(``tools/calibrate_verdicts.py``).
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse._posterior import DOUBT, SHARE, SunPosterior
from skylight.inverse._scores import CAP_RAD, MapLamp, find_lamps
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angle_between

Word = Literal["sure", "rough", "unknown"]
# At most: degrees, of 90 % and of two in three; and factors of brightness and of red or blue over
# green, of 90 %.
SURE_DEG, ROUGH_DEG = 14.0, 20.0
SURE_FACTOR, ROUGH_FACTOR = 1.25, 2.0
SURE_TINT, ROUGH_TINT = 1.15, 1.6
# k and e of the module's text, of brightness and of colour
LEVEL_SCALE, LEVEL_FLOOR = 1.8, 0.1
TINT_SCALE, TINT_FLOOR = 3.0, 0.05
_NORMAL = 1.645  # standard deviations within which a normal density has 90 %

CAMERA = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)  # from the face
# A flash on a camera, seen from a portrait's distance, and doubt
AT_CAMERA_RAD = math.radians(12.0)
# Of the light, within 15 degrees: what comes from there is thrice as bright as the mean; it shows
SOURCE_SHARE, GLOW_SHARE = 0.05, 0.02
HARD_SHARE = 0.2  # lights what faces it as much as all other light does
HARD_RAD = math.radians(6.0)  # rms of a source's light about its middle: shadows have edges
EVEN = 0.15  # length of int L w dw / int L dw: below, no side is brighter
APART_RAD = math.radians(45.0)  # less, and it is one source
ELSEWHERE_RAD = math.radians(60.0)  # what the map shows is not what the face says
_ROWS = 32


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """How sure one property of the light is: 90 % of such estimates are off by ``within`` at most.

    ``within`` is an angle in degrees, or a factor. ``reason`` is a clause for people.
    """

    word: Word
    within: float
    reason: str

    def __str__(self) -> str:
        return f"{self.word}: {self.reason}"


@dataclass(frozen=True, kw_only=True)
class Spreads:
    """s of the module's text before k and e: of log ``level`` and log ``tint``."""

    level: float
    tint: float


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the light is, and how sure its direction, brightness and colour are.

    ``light`` is a sentence about the map. ``doubt`` is why none of it should be trusted; "" where
    the face is explained.
    """

    light: str
    direction: Certainty
    brightness: Certainty
    colour: Certainty
    doubt: str = ""

    @property
    def summary(self) -> str:
        """In one line: "direction sure, brightness rough, colour rough"."""
        if self.doubt:
            return f"unreliable: {self.doubt}"
        return (
            f"direction {self.direction.word}, brightness {self.brightness.word}, "
            f"colour {self.colour.word}"
        )


def verdict_of(
    environment: EnvironmentMap,
    found: Float[Tensor, "3"],
    posterior: SunPosterior,
    spreads: Spreads,
    *,
    doubt: str = "",
    background: Literal["unseen", "used", "doubted"] = "unseen",
) -> Verdict:
    """The verdict on a map whose main light was ``found`` in that direction.

    ``doubt`` is why the face is not explained; ``background`` is what the photograph's had to do
    with it.
    """
    light, shown = light_in_words(environment, seen=posterior.is_seen)
    return Verdict(
        light=light,
        direction=_direction(found, posterior, doubt, shown),
        brightness=_factor(
            math.hypot(LEVEL_SCALE * spreads.level, LEVEL_FLOOR),
            SURE_FACTOR,
            ROUGH_FACTOR,
            doubt,
            "the skin may be darker or lighter",
            background,
        ),
        colour=_factor(
            math.hypot(TINT_SCALE * spreads.tint, TINT_FLOOR),
            SURE_TINT,
            ROUGH_TINT,
            doubt,
            "the skin's own colour is a guess",
            background,
        ),
        doubt=doubt,
    )


def spread_of(interval: tuple[float, float]) -> float:
    """Standard deviation of the log of what lies within that with 90 %."""
    return math.log(interval[1] / interval[0]) / (2 * _NORMAL)


def _factor(
    spread: float, sure: float, rough: float, doubt: str, of_skin: str, background: str
) -> Certainty:
    """Of a quantity whose log has that ``spread``; ``of_skin`` is what the face leaves open."""
    within = math.exp(min(_NORMAL * spread, 20.0))
    if doubt:
        return Certainty(word="unknown", within=within, reason=doubt)
    word: Word = "sure" if within <= sure else "rough" if within <= rough else "unknown"
    reason = of_skin
    if background == "doubted":
        reason = f"{of_skin}, and the background looks like other light"
    elif background == "used" and word == "unknown":
        reason = f"{of_skin}, and the background does not settle it"
    elif background == "used":
        reason = "the background shows it"
    return Certainty(word=word, within=within, reason=f"within a factor of {within:.2g}, {reason}")


def _direction(
    found: Float[Tensor, "3"],
    posterior: SunPosterior,
    doubt: str,
    shown: list[Float[Tensor, "3"]],
) -> Certainty:
    """By the posterior, unless the face has shown no direction at all."""
    found = found.double()
    within, likely = (math.degrees(_cap_rad(posterior, found, share)) for share in (SHARE, 2 / 3))
    against = doubt
    if not against and not shown:
        against = "the light is even: no side stands out"
    if not against and not posterior.is_seen:
        against = "the face is lit too evenly to tell"
    if not against and posterior.by_camera and float(angle_between(found, CAMERA)) > AT_CAMERA_RAD:
        against = "a flash at the camera would light the face alike"
    if not against and all(float(angle_between(found, one)) > ELSEWHERE_RAD for one in shown):
        against = "most light comes from elsewhere than the face says"
    if against:
        return Certainty(word="unknown", within=within, reason=against)
    word: Word = "sure" if within <= SURE_DEG else "rough" if likely <= ROUGH_DEG else "unknown"
    reason = f"within {within:.0f}°"
    if word == "rough":
        reason = f"two times in three within {likely:.0f}°"
    if posterior.clock_wrong is not None and posterior.clock_wrong > DOUBT:
        word = "unknown" if word == "unknown" else "rough"
        reason = "the face and the clock disagree"
    elif word != "sure" and len(posterior.parts) > 1 and posterior.parts[1].share > 0.1 * SHARE:
        also = f"it may come {place(_other(posterior, found))} too"
        reason = also if word == "unknown" else f"{reason}, but {also}"
    elif word == "unknown" and float(found[2]) < 0:
        reason = "it comes from behind the face, which sees little of it"
    return Certainty(word=word, within=within, reason=reason)


def _other(posterior: SunPosterior, found: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """The middle of the likelier of the two first parts that the light was not found in."""
    first, second = posterior.parts[:2]
    nearer = float(first.peak.double() @ found) >= float(second.peak.double() @ found)
    return second.peak if nearer else first.peak


def _cap_rad(posterior: SunPosterior, found: Float[Tensor, "3"], share: float) -> float:
    """r of the module's text, of any share."""
    cosine = posterior.grid.directions.double() @ found
    mass = (posterior.density * posterior.grid.solid_angles).double()
    order = cosine.argsort(descending=True)
    reached = mass[order].cumsum(0)
    last = int((reached < share * reached[-1]).sum())
    return float(cosine[order[min(last, len(order) - 1)]].clamp(-1, 1).acos())


def light_in_words(
    environment: EnvironmentMap, *, seen: bool = True
) -> tuple[str, list[Float[Tensor, "3"]]]:
    """What light a full map is, and where that comes from: nowhere where it is even.

    Such as "hard light from the left, high; and soft light from behind".

    Its sources are those of :func:`~skylight.inverse._scores.find_lamps` with a twentieth of the
    light. One is hard that lights what faces it as much as all other light does, and comes from
    within some degrees. Without any, the light is soft, from where its mean ``int L w dw`` points,
    or even, but for a glow that is too little light to be a source. Whether it is hard is left out
    where no face has ``seen`` a main light.
    """
    sources = _sources(environment)
    if not sources or sources[0].share < SOURCE_SHARE:
        mean = _mean_vector(environment)
        shown = [] if float(mean.norm()) < EVEN else [mean / mean.norm()]
        light = f"soft light {place(mean)}" if shown else "even light from all around"
        return f"{light}, a glow {place(sources[0].direction)}" if sources else light, shown
    named = [
        f"{('hard ' if one.is_hard else 'soft ') * seen}light {place(one.direction)}"
        for one in sources
    ]
    words = named[0] if len(named) == 1 else f"{'; '.join(named[:-1])}; and {named[-1]}"
    return words, [one.direction.double() for one in sources]


@dataclass(frozen=True, kw_only=True)
class _Source:
    """A lamp of the map and whether it is hard."""

    direction: Float[Tensor, "3"]
    share: float
    is_hard: bool


def _sources(environment: EnvironmentMap) -> list[_Source]:
    """The map's, the strongest first, those beside a stronger one left out."""
    kept: list[MapLamp] = []
    for lamp in find_lamps(environment, least_share=GLOW_SHARE, rows=_ROWS):
        least = SOURCE_SHARE if kept else GLOW_SHARE
        if lamp.share > least and all(
            float(angle_between(lamp.direction, one.direction)) > APART_RAD for one in kept
        ):
            kept.append(lamp)
    return [
        _Source(direction=lamp.direction, share=lamp.share, is_hard=_is_hard(environment, lamp))
        for lamp in kept
    ]


def _is_hard(environment: EnvironmentMap, lamp: MapLamp) -> bool:
    level, grid = luminance(environment.flat).double(), environment.grid
    angles = (grid.directions.double() @ lamp.direction.double()).clamp(-1, 1).acos()
    near = angles < CAP_RAD
    excess = ((level - level.median()).clamp(min=0) * grid.solid_angles)[near]
    spread = float((excess @ angles[near].square() / excess.sum().clamp(min=1e-30)).sqrt())
    return lamp.share > HARD_SHARE and spread < HARD_RAD


def _mean_vector(environment: EnvironmentMap) -> Float[Tensor, "3"]:
    """``int L w dw / int L dw``."""
    weights = luminance(environment.flat).double() * environment.grid.solid_angles.double()
    return weights @ environment.grid.directions.double() / weights.sum().clamp(min=1e-30)


def place(direction: Float[Tensor, "3"]) -> str:
    """Where light comes from, as seen in the photograph: "from behind on the left, high".

    Left and right are the picture's, and "behind" is behind the person.
    """
    x, y, z = (direction / direction.norm()).tolist()
    if y > math.cos(math.radians(20)):
        return "from above"
    if y < -math.cos(math.radians(20)):
        return "from below"
    if float(angle_between(direction.double(), CAMERA)) < AT_CAMERA_RAD:
        return "from the camera"
    around = abs(math.degrees(math.atan2(x, z)))
    side = "left" if x < 0 else "right"
    if around < 25:
        where = "from the front"
    elif around < 65:
        where = f"from the front {side}"
    elif around < 115:
        where = f"from the {side}"
    else:
        where = "from behind" + (f" on the {side}" if around < 155 else "")
    elevation = math.degrees(math.asin(max(-1.0, min(1.0, y))))
    heights = ((45, "high"), (15, ""), (-15, "low"), (-90, "from below"))
    height = next(name for least, name in heights if elevation >= least)
    return f"{where}, {height}" if height else where
