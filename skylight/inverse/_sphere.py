"""Observations under light from all round, of any place: smooth light and up to three lamps.

As lamps in ambient light (:mod:`skylight.inverse._lamps`), with the light model that knows places
(:mod:`skylight.models._sphere`).
"""

import math
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight._names import Place
from skylight.inverse._auto import open_sky_log_odds
from skylight.inverse._descent import Stage
from skylight.inverse._faces import Level
from skylight.inverse._lamps import LampFamily, LampsOptions, LampsProblem
from skylight.inverse._sun_prior import SunPrior
from skylight.models._ground import KnownGround
from skylight.models._prior import GaussianMixture
from skylight.models._sphere import Places, SphereLight, SpherePrior, shipped

CAMERA_DIRECTION = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)  # from the face
INDOORS, OPEN_SKY = ("home", "workplace", "studio", "car"), ("outdoors", "street")
RULED_OUT: dict[Place, tuple[str, ...]] = {"outdoors": INDOORS, "indoors": OPEN_SKY}
# Of streets, which are simulated at night, where "outdoors" is all that is known: few people are
# photographed there, and a face in even light does not tell
NIGHT_LOG_ODDS = -3.0
# Nats of evidence that one more lamp is to bring, set by six rendered people in simulated places:
# what light is like, the prior knows; what heads are wrong by, it does not
LEAST_GAIN = 8.0
# There are many latents, so what is coarse is coarse in light too
COARSE = (
    Stage(level=Level(2, light=1), starts=5, iterations=6, even_skin=True, steps="broyden"),
    Stage(level=Level(1, light=1), starts=3, iterations=8, even_skin=True, steps="broyden"),
)
FINE = (
    Stage(level=Level(0), starts=1, iterations=8, steps="broyden"),
    Stage(level=Level(0), starts=1, iterations=5, steps="broyden"),
)


def sphere_problem(
    albedo_prior: GaussianMixture,
    albedo_modes: Float[Tensor, "k 3"],
    options: LampsOptions,
    place: Place = "auto",
    exposure: float | None = None,
    sun_prior: SunPrior | None = None,
    ground: KnownGround | None = None,
    places: Places | None = None,
) -> LampsProblem:
    """An empty problem of this light, in a ``place`` and over a ``ground`` where they are known.

    The ``exposure`` value tells open sky by day from rooms and nights. ``sun_prior`` is what clock
    and place tell: the main light is the sun as likely as the place is under the open sky, and
    that of a flash is the camera's. ``places`` are what was learnt of them, by default what comes
    with skylight.
    """
    places = places or shipped()
    known = {"outdoors": open_sky_log_odds(exposure)}
    known |= dict.fromkeys(RULED_OUT.get(place, ()), -math.inf)
    if place == "outdoors":
        known["street"] = NIGHT_LOG_ODDS
    log_odds = {kind: odds for kind, odds in known.items() if kind in places.kinds}
    family = LampFamily(
        light=partial(SphereLight, places=places),
        prior=lambda lamps: SpherePrior(lamps, places, log_odds),
        least_gain=LEAST_GAIN,
        patience=2,
        smooth=True,
        apart=partial(_by_sky, places),
    )
    weights = replace(options.weights, noise_of_face=True)
    efforts = replace(options, coarse=COARSE, fine=FINE, weights=weights)
    if sun_prior is not None:
        prior = SpherePrior(0, places, log_odds)
        open_sky = float(prior.log_weights[_under_open_sky(prior)].exp().sum())
        sun_prior = sun_prior.anywhere(0.0 if place == "flash" else open_sky)
    return LampsProblem(
        albedo_prior,
        albedo_modes,
        efforts,
        family,
        towards=towards_of(place),
        sun_prior=sun_prior,
        ground=ground,
    )


def _under_open_sky(places: Places | SpherePrior) -> Bool[Tensor, " m"]:
    """Which components are of places there."""
    return torch.tensor([kind in OPEN_SKY for kind in places.kinds])[places.kind]


def _by_sky(places: Places, candidates: Float[Tensor, "s c p"]) -> list[Float[Tensor, "s _ p"]]:
    """Those of places under the open sky, and of others.

    What fits best to begin with are rooms, which are of all kinds: it is not what is likeliest in
    the end. Of each set of lamps there are as many candidates for each component.
    """
    is_open = _under_open_sky(places)
    mine = is_open.repeat_interleave(candidates.shape[1] // len(is_open))
    groups = [candidates[:, mine], candidates[:, ~mine]]
    return [each for each in groups if each.shape[1]]


def towards_of(place: Place) -> Float[Tensor, "1 3"] | None:
    """Where one lamp is looked for besides: at the camera, where a flash was fired."""
    return CAMERA_DIRECTION[None] if place == "flash" else None
