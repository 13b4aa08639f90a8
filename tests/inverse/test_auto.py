"""Skies and lamps compete: balls whose light is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.inverse._auto import LEAD, TEMPERATURE, choose, open_sky_log_odds
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import estimate_light, light_problems, smooth_autoencoder
from skylight.inverse._faces import Level
from skylight.inverse._problem import solve
from skylight.inverse._sky import SolverOptions
from skylight.models._bundle import load_bundle
from skylight.models._ground import LambertianGround
from tests.inverse.test_lamps import lit_ball
from tests.inverse.test_solve import MODES, ball_normals, observed


def under_a_learnt_sky():
    """A ball of skin under a sky that the decoder makes, with its sun on the camera's side."""
    model = smooth_autoencoder(load_bundle())
    sun = torch.nn.functional.normalize(torch.tensor([[0.6, 0.5, 0.7]], dtype=torch.float64))
    with torch.no_grad():
        sky = model(model.starts_towards(sun)[0, :1])
        light = LambertianGround(32).append(sky, torch.full((1, 3), 0.12))[0].double()
    blank = observed(np.zeros((len(ball_normals()[0]), 3)))
    specular = blank.specular.matrix.double() @ light
    return observed(
        (MODES[0].double() * (blank.transport.matrix.double() @ light) + specular).numpy()
    )


QUICK = SolverOptions(stages=(Stage(level=Level(2), starts=2, iterations=3),))


def seen_from_below():
    return lit_ball(((0.6, -0.6, 0.6), 3.0))


@pytest.fixture(scope="module")
def from_below():
    """Of little effort: what is made of two estimates is not how well they were found."""
    return estimate_light(seen_from_below(), "auto", options=QUICK)


@pytest.mark.slow
def test_light_from_below_is_no_sky():
    from_below = estimate_light(seen_from_below(), "auto")
    assert from_below.light == "lamps"
    assert from_below.choice.probability > 0.95
    evidence = from_below.choice.log_evidence
    assert evidence["lamps"] > evidence["autoencoder"] + 3 * TEMPERATURE


@pytest.mark.slow
def test_a_sky_is_a_sky():
    found = estimate_light(under_a_learnt_sky(), "auto")
    assert found.light == "autoencoder"
    assert found.choice.probability > 0.6


def test_the_likeliest_is_chosen_and_as_sure_as_the_gap_says(from_below):
    other = replace(from_below, light="autoencoder", log_evidence=-5.0)
    one = replace(from_below, log_evidence=-5.0 + LEAD + TEMPERATURE)
    for rivals in ([one, other], [other, one]):
        found = choose(rivals)
        assert found.light == "lamps"
        assert found.choice.probability == pytest.approx(torch.tensor(1.0).sigmoid().item())


def test_the_exposure_weighs_in(from_below):
    """Bright pictures speak for a sky, dark ones against it, by odds of 5 and 20 at most."""
    sky = replace(from_below, light="autoencoder", log_evidence=0.0)

    def chosen(lead: float, exposure: float | None) -> str:
        return choose([sky, replace(from_below, log_evidence=LEAD + lead)], exposure).light

    assert [chosen(lead, None) for lead in (-1, 1)] == ["autoencoder", "lamps"]
    assert [chosen(lead, 14.0) for lead in (60, 70)] == ["autoencoder", "lamps"]
    assert [chosen(lead, 5.0) for lead in (-125, -115)] == ["autoencoder", "lamps"]
    even = choose([sky, replace(from_below, log_evidence=LEAD)], 14.0)
    assert even.choice.probability == pytest.approx(5 / 6)
    assert even.choice.exposure_log_odds == pytest.approx(math.log(5))
    assert open_sky_log_odds(10.5) == pytest.approx(
        math.log(4 / 3) - 0.5 * (2.5 / 1.5) ** 2 + 0.5 * (3.5 / 2) ** 2
    )
    assert light_problems("auto", exposures=[5.0])[0].exposure == 5.0
    assert (
        open_sky_log_odds(40.0)
        == open_sky_log_odds(20.0)
        == open_sky_log_odds(13.0)
        == pytest.approx(math.log(5))
    )
    assert open_sky_log_odds(-3.0) == open_sky_log_odds(7.0) == pytest.approx(-math.log(20))


def test_without_observations():
    with pytest.raises(InputError, match="no observation"):
        solve(light_problems("auto"))
