"""Clock and place with light of any place, where the main light is the sun or something else."""

import math

import pytest
import torch
from torch.nn.functional import normalize

from skylight.inverse._estimate import estimate_light, light_problems
from skylight.inverse._faces import FaceTerm, ObjectiveWeights
from skylight.inverse._lamps import LampsProblem
from skylight.inverse._objective import LightObjective
from skylight.inverse._own_light import follows_clock
from skylight.inverse._posterior import SunEvidence, clock_wrong, credible, sun_density
from skylight.inverse._sun_prior import FLOOR, SunPrior
from skylight.models._sphere import SphereLight, SpherePrior
from skylight.sphere._frame import DirectionGrid, angle_between, angles_from_direction
from tests.inverse.test_lamps import ONE, lit_ball
from tests.inverse.test_objective import normal
from tests.inverse.test_shared_light import half_ball
from tests.inverse.test_sun_prior import about, direction

GRID = DirectionGrid.latlong(128)
SUN = normalize(torch.tensor(ONE, dtype=torch.float64), dim=0)
AZIMUTH_DEG, ZENITH_DEG = (math.degrees(float(angle)) for angle in angles_from_direction(SUN))


def anywhere(azimuth_deg: float, zenith_deg: float, open_sky: float = 0.5) -> SunPrior:
    prior = about(azimuth_deg, zenith_deg).anywhere(open_sky)
    assert prior is not None
    return prior


def evidence_for(towards: torch.Tensor | None) -> SunEvidence:
    """Of a face that one lamp explains, or that says nothing, all round."""
    cells = DirectionGrid.latlong(32).directions
    off = torch.zeros(len(cells)).double() if towards is None else 0.6 * (1 - cells @ towards)
    return SunEvidence(deviations=off, gain=0.5)


# ---- the density


@pytest.mark.parametrize("zenith_deg", [0.0, 50.0, 88.0])
def test_it_is_a_density_over_the_sphere_of_one_light_of_several(zenith_deg: float) -> None:
    """Over an even density it is 1 in the mean: no number of lamps is preferred beforehand."""
    prior = anywhere(40.0, zenith_deg, 0.7)
    one = GRID.directions[:, None]
    share = GRID.solid_angles / (4 * math.pi)
    ratio = prior.of_one(one).exp() * prior.area
    assert float(share @ ratio) == pytest.approx(1, abs=3e-3)
    other = direction(41.0, zenith_deg - 2).expand(len(one), 1, 3)
    alone = prior.of_one(other[:1]).exp() * prior.area
    both = prior.of_one(torch.cat([one, other], 1)).exp() * prior.area
    assert float(share @ both) == pytest.approx((1 + float(alone[0])) / 2, rel=2e-3)


def test_a_low_sun_may_be_below_the_horizon_of_a_tilted_camera() -> None:
    below = direction(40.0, 91.5)
    prior = anywhere(40.0, 88.0)
    assert float(prior.log_density(below)) > math.log(20 * prior.elsewhere)


def test_elsewhere_it_pulls_nothing() -> None:
    lamp = direction(-120.0, 60.0).requires_grad_(True)
    (slope,) = torch.autograd.grad(anywhere(60.0, 40.0).of_one(lamp[None]), lamp)
    assert float(slope.norm()) < 1e-6


def test_places_without_a_sky_have_no_clock() -> None:
    def told(place: str) -> SunPrior | None:
        (problem,) = light_problems(
            "sphere", sun_priors=[about(0.0, 40.0)], place=place, device="cpu"
        )
        assert isinstance(problem, LampsProblem)
        return problem.faces.sun_prior

    assert told("indoors") is None
    assert told("flash") is None
    assert told("outdoors").floor == pytest.approx(FLOOR, rel=1e-5)
    assert FLOOR < told("auto").floor < 1
    assert follows_clock("sphere", None)
    assert not follows_clock("sphere", None, "indoors")


# ---- whether it counts


def test_a_lamp_elsewhere_leaves_the_clock_out_and_says_nothing_against_it() -> None:
    prior, lamp = anywhere(60.0, 40.0), direction(-120.0, 60.0)
    assert credible(evidence_for(lamp), prior) is None
    assert clock_wrong(evidence_for(lamp), prior) < 0.1
    assert credible(evidence_for(direction(62.0, 45.0)), prior) is prior
    # who knows that the place is outdoors knows that something is wrong
    outdoors = anywhere(60.0, 40.0, 1.0)
    assert clock_wrong(evidence_for(lamp), outdoors) > 0.5


def test_how_likely_the_clock_is_wrong_by_hand() -> None:
    """A face that says nothing leaves what was thought before."""
    assert clock_wrong(evidence_for(None), anywhere(0.0, 45.0, 0.7)) == pytest.approx(
        0.7 * FLOOR, rel=0.01
    )


def test_the_posterior_has_it_all_round() -> None:
    prior = anywhere(60.0, 40.0)
    density = sun_density(evidence_for(None), None, sun_prior=prior)
    grid = DirectionGrid.latlong(32)
    expected = prior.log_density(grid.directions).exp()
    expected = expected / (expected @ grid.solid_angles)
    torch.testing.assert_close(density, expected, rtol=0.05, atol=1e-3)


def test_the_objective_takes_the_sun_for_one_of_the_lamps() -> None:
    face, weights, prior = (
        FaceTerm.of(half_ball(), sphere=True),
        ObjectiveWeights(),
        anywhere(0, 50),
    )
    for count in (0, 2):
        model = SphereLight(count)
        told = LightObjective([face], model, SpherePrior(count), normal(3), weights, [prior])
        params = model.starts()[:3]
        nll = told.sun_nll(params)
        if count == 0:
            assert nll is None
            continue
        each = prior.log_density(model.lamps(params).directions).exp()
        torch.testing.assert_close(nll, -weights.sun_prior * each.mean(1).log())


# ---- a ball in one lamp


@pytest.mark.slow
def test_the_sun_is_drawn_to_where_the_clock_says() -> None:
    ball = lit_ball((ONE, 3.0))
    plain = estimate_light(ball, "sphere", device="cpu")
    told = direction(AZIMUTH_DEG + 6, ZENITH_DEG - 3)
    found = estimate_light(
        ball, "sphere", sun_prior=about(AZIMUTH_DEG + 6, ZENITH_DEG - 3), device="cpu"
    )
    assert len(found.lamps) == len(plain.lamps) == 1
    nearer = float(angle_between(found.sun_direction, told))
    assert nearer < float(angle_between(plain.sun_direction, told))
    assert math.degrees(float(angle_between(found.sun_direction, SUN))) < 2
    assert found.posterior.region_sr < 0.8 * plain.posterior.region_sr
    assert found.posterior.clock_wrong < 0.02


@pytest.mark.slow
def test_a_clock_chooses_between_two_lamps_and_bends_nothing_where_neither_is_the_sun() -> None:
    x, y, z = ONE
    room = lit_ball((ONE, 3.0), ((-x, y, z), 3.0))
    plain = estimate_light(room, "sphere", device="cpu")
    for far in (about(0.0, 40.0), about(180.0, 30.0)):
        found = estimate_light(room, "sphere", sun_prior=far, device="cpu")
        assert torch.equal(found.environment.radiance, plain.environment.radiance)
        assert found.verdict.direction.reason != "the face and the clock disagree"
    agreed = estimate_light(room, "sphere", sun_prior=about(AZIMUTH_DEG + 8, ZENITH_DEG))
    nearest = min(float(angle_between(lamp.direction, SUN)) for lamp in agreed.lamps)
    assert math.degrees(nearest) < 3
