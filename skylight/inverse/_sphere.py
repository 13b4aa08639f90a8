"""Observations under light from all round, of any place: smooth light and up to three lamps.

As lamps in ambient light (:mod:`skylight.inverse._lamps`), with the light model that knows places
(:mod:`skylight.models._sphere`), after lamps in nearly even light, which tell where the main one
is.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight._names import Place
from skylight.inverse._auto import open_sky_log_odds
from skylight.inverse._descent import Stage
from skylight.inverse._faces import Level
from skylight.inverse._lamps import LAMPS, LampFamily, LampsOptions, LampsProblem
from skylight.inverse._sun_prior import SunPrior
from skylight.inverse._verdict import CAMERA
from skylight.models._ground import KnownGround
from skylight.models._prior import GaussianMixture
from skylight.models._sphere import Places, SphereLight, SpherePrior, shipped

INDOORS, OPEN_SKY = ("home", "workplace", "studio", "car"), ("outdoors", "street")
RULED_OUT: dict[Place, tuple[str, ...]] = {"outdoors": INDOORS, "indoors": OPEN_SKY}
# Of what stands behind people, plants and skies are seen by day
NOT_BY_DAY = (*INDOORS, "street")
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

    def family(log_odds: Mapping[str, float]) -> LampFamily:
        of_these = {kind: odds for kind, odds in log_odds.items() if kind in places.kinds}
        return LampFamily(
            light=partial(SphereLight, places=places),
            prior=lambda lamps: SpherePrior(lamps, places, of_these),
            least_gain=LEAST_GAIN,
            patience=2,
            smooth=True,
            apart=partial(_by_sky, places, of_these),
            guide=LAMPS,
        )

    by_day = replace(family(known | dict.fromkeys(NOT_BY_DAY, -math.inf)), most=1)  # the sun
    seen = place in ("auto", "outdoors") and "outdoors" in places.kinds
    weights = replace(options.weights, noise_of_face=True)
    efforts = replace(options, coarse=COARSE, fine=FINE, weights=weights)
    if sun_prior is not None:
        prior = family(known).prior(0)
        assert isinstance(prior, SpherePrior)
        open_sky = float(prior.log_weights[_under_open_sky(prior)].exp().sum())
        sun_prior = sun_prior.anywhere(0.0 if place == "flash" else open_sky)
    return LampsProblem(
        albedo_prior,
        albedo_modes,
        efforts,
        family(known),
        towards=towards_of(place),
        sun_prior=sun_prior,
        ground=ground,
        outdoors=by_day if seen else None,
    )


def _under_open_sky(places: Places | SpherePrior) -> Bool[Tensor, " m"]:
    """Which components are of places there."""
    return torch.tensor([kind in OPEN_SKY for kind in places.kinds])[places.kind]


def _by_sky(
    places: Places, log_odds: Mapping[str, float], candidates: Float[Tensor, "s c p"]
) -> list[Float[Tensor, "s _ p"]]:
    """Those of places under the open sky, and of others, without what is ruled out.

    What fits best to begin with are rooms, which are of all kinds: it is not what is likeliest in
    the end. Of each set of lamps there are as many candidates for each component.
    """
    possible = torch.tensor([log_odds.get(kind, 0.0) > -math.inf for kind in places.kinds])
    is_open, possible = _under_open_sky(places), possible[places.kind]
    each = candidates.shape[1] // len(is_open)
    groups = [is_open & possible, ~is_open & possible]
    return [candidates[:, mine.repeat_interleave(each)] for mine in groups if mine.any()]


def towards_of(place: Place) -> Float[Tensor, "1 3"] | None:
    """Where one lamp is looked for besides: at the camera, where a flash was fired."""
    return CAMERA[None] if place == "flash" else None
