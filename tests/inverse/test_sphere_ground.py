"""Known ground below light of the whole sphere: its density, by hand, and its use."""

import math
from dataclasses import replace

import pytest
import torch
from scipy.stats import multivariate_t

from skylight.errors import InputError
from skylight.inverse._estimate import estimate_light
from skylight.inverse._faces import FaceTerm, ObjectiveWeights
from skylight.inverse._objective import LightObjective
from skylight.inverse._sky import SolverOptions
from skylight.inverse._solution import measured_ground
from skylight.models._ground import (
    GroundBelow,
    KnownGround,
    LambertianGround,
    below_and_above,
    check_has_ground,
)
from skylight.models._sphere import SphereLight, SpherePrior
from skylight.sphere._envmap import EnvironmentMap
from tests.inverse.test_lamps import ONE, lit_ball
from tests.inverse.test_objective import normal
from tests.inverse.test_shared_light import half_ball

KNOWN = KnownGround(albedo=(0.2, 0.15, 0.1), spread=0.1)


def over(albedo: torch.Tensor, height: int, seed: int = 0) -> torch.Tensor:
    """Any sky over a Lambertian ground of that albedo."""
    generator = torch.Generator().manual_seed(seed)
    sky = torch.rand(height * height, 3, generator=generator).double() ** 4
    return LambertianGround(height // 2).append(sky, albedo.double())


def test_an_even_light_is_as_bright_below_as_above() -> None:
    for height in (8, 64):
        torch.testing.assert_close(
            below_and_above(height).sum(1), torch.ones(2).double(), rtol=1e-9, atol=0
        )


def test_a_ground_is_measured_as_what_it_is() -> None:
    albedo = torch.tensor(KNOWN.albedo)
    radiance = over(albedo, 32).float().reshape(32, 64, 3)
    torch.testing.assert_close(
        measured_ground(EnvironmentMap(radiance=radiance)), albedo, rtol=1e-5, atol=0
    )


def test_its_density_is_students_of_the_ratio_of_below_and_above() -> None:
    prior = GroundBelow(KNOWN).double()
    albedo = torch.tensor(KNOWN.albedo)
    assert float(prior.log_prob(over(albedo, 8))) == pytest.approx(0, abs=1e-9)
    own = GroundBelow.COLOUR**2 + KNOWN.spread**2
    scale = GroundBelow.LEVEL**2 * torch.ones(3, 3) + own * torch.eye(3)
    student = multivariate_t(shape=scale.numpy(), df=GroundBelow.FREEDOM)
    for off in ([0.3, 0.3, 0.3], [0.2, -0.1, 0.0], [2.0, 1.9, 1.5]):
        found = prior.log_prob(over(albedo * torch.tensor(off).exp(), 8, seed=1))
        expected = student.logpdf(off) - student.logpdf([0, 0, 0])
        assert float(found) == pytest.approx(float(expected), rel=1e-5)
    # of the picture's units it says nothing
    light = over(albedo * 2, 8)
    torch.testing.assert_close(prior.log_prob(7 * light), prior.log_prob(light))


def test_the_objective_counts_it() -> None:
    face, model = FaceTerm.of(half_ball().on_rows(32), sphere=True), SphereLight(1)
    plain, told = (
        LightObjective([face], model, SpherePrior(1), normal(3), ObjectiveWeights(), (), known)
        for known in (None, KNOWN)
    )
    light = model.starts()[:2]
    ones = torch.ones(2, 1)
    free = plain.pack(light, ones, ones, 0.3 * torch.ones(2, 1, 3), torch.empty(2, 0))
    assert "ground_prior" not in plain.priors(free)
    expected = -GroundBelow(KNOWN).log_prob(model.on_rows(GroundBelow.HEIGHT)(light))
    torch.testing.assert_close(told.priors(free)["ground_prior"], expected)


def test_which_lights_have_use_for_it() -> None:
    check_has_ground("sphere", KNOWN)
    for light in ("lamps", "sh9"):
        with pytest.raises(InputError, match="leave it out, or choose --light sphere"):
            check_has_ground(light, KNOWN)


@pytest.mark.slow
def test_a_face_that_does_not_see_the_ground_believes_it() -> None:
    """Only what faces the upper half is seen: the lower half's light is not told by the ball."""
    ball = lit_ball((ONE, 3.0), ambient=0.4)
    centre = ball.places.double().mean(0)
    seen = replace(ball, weights=ball.weights * (ball.places[:, 0] < centre[0] - 3))
    off = []
    for albedo in (0.08, 0.6):
        ground = KnownGround(albedo=(albedo,) * 3)
        for options in (SolverOptions(), SolverOptions(ground=ground)):
            found = estimate_light(seen, "sphere", options=options, device="cpu")
            off.append(abs(math.log(float(found.ground_albedo[1]) / albedo)))
    assert off[1] < 0.7 * off[0]
    assert off[3] < max(0.7 * off[2], 0.15)
