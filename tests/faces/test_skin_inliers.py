"""Which pixels are skin: rendered faces on which something else was painted."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.faces import _skin_inliers as skin_inliers
from skylight.faces._model import HeadModel, Region
from skylight.faces._observe import observe_face
from skylight.faces._skin_inliers import inlier_probability
from skylight.faces._synthetic import render_face
from skylight.sphere._envmap import EnvironmentMap

LIGHTS = {"sky": None, "sun before the face": (5, 58), "sun beside the face": (6, 52)}
PATCHES = ("beard", "sunglasses", "hand", "strands")


@pytest.fixture(scope="module", params=LIGHTS)
def seen(request):
    """(observation of a clean face, places of its pixels in the head, in metres)."""
    radiance = torch.tensor([0.8, 0.9, 1.1]).expand(16, 64, 3).clone()
    if place := LIGHTS[request.param]:
        radiance *= 0.25  # so that the sun gives hard shadows
        radiance[place] = torch.tensor([500.0, 430.0, 330.0])
    head = HeadModel.load()
    person = render_face(
        EnvironmentMap(radiance=radiance),
        torch.tensor([0.2, 0.2, 0.2]),
        seed=900,
        size=160,
        azimuth_rad=0.0,
        light_rows=16,
    )
    with pytest.MonkeyPatch.context() as patch:  # every pixel that may be skin
        patch.setattr("skylight.faces._observe.LEAST_INLIER", -1.0)
        patch.setattr("skylight.faces._observe.BLOCK", 1)
        view = observe_face(
            person.picture, person.clipped, head, person.truth, face_height_px=56, grid_height=16
        )
    observation = replace(view.observation, weights=torch.ones(len(view.observation.pixels)))
    shown = view.surface.positions[view.used].numpy() - person.truth.translation
    return (
        observation,
        shown @ person.truth.rotation,
        head.vertices(person.truth.identity, person.truth.expression),
    )


def painted(observation, at, vertices, what):
    """(the observation with something on the skin, the pixels that show it)."""
    rng = np.random.default_rng(0)
    regions = HeadModel.load().regions
    eyes, lips = (vertices[regions == part].mean(0) for part in (Region.EYEBALL, Region.LIPS))
    x, y, _ = at.T
    if what == "beard":
        there = (y < lips[1] + 0.012) & (y > lips[1] - 0.07)
        factor = np.array([0.2, 0.23, 0.28]) * np.exp(0.3 * rng.normal(size=(len(x), 1)))
    elif what == "sunglasses":
        there = (abs(y - eyes[1] + 0.004) < 0.022) & (abs(x) < 0.07)
        factor = 0.04 + 0.04 * rng.random((len(x), 1)) * np.ones(3)
    elif what == "hand":  # fingers in the shade of the hand, redder than the face
        there = (x > 0.01) & (abs(y - lips[1]) < 0.035)
        factor = (0.2 + 0.25 * abs(np.sin(x * 300)))[:, None] * [1.1, 0.95, 0.9]
    else:
        rows, columns = observation.places.numpy().T
        there = ((columns + rows // 3) % 9 == 0) & (y > eyes[1] - 0.02)
        factor = np.tile([0.15, 0.14, 0.13], (len(x), 1))
    factor = torch.from_numpy(np.where(there[:, None], factor, 1.0)).float()
    return replace(observation, pixels=observation.pixels * factor), there


@pytest.mark.parametrize("what", PATCHES)
def test_what_is_painted_on_is_found_and_skin_stays(seen, what):
    observation, there = painted(*seen, what)
    assert 0.03 < there.mean() < 0.4
    inlier = inlier_probability(observation).numpy()
    assert (inlier[there] < 0.5).mean() > 0.8
    assert (inlier[~there] > 0.5).mean() > 0.9


def test_shadows_are_no_outliers(seen):
    observation, *_ = seen
    inlier = inlier_probability(observation)
    assert float((inlier > 0.5).float().mean()) > 0.97
    dark = observation.pixels[:, 1] < 0.25 * observation.pixels[:, 1].quantile(0.9)
    if int(dark.sum()) > 50:
        assert float((inlier[dark] > 0.5).float().mean()) > 0.85


@pytest.mark.parametrize("seen", ["sun beside the face"], indirect=True)
def test_exposure_does_not_matter(seen):
    observation, _ = painted(*seen, "beard")
    expected = inlier_probability(observation)
    for factor in (1e-3, 50.0):
        scaled = replace(observation, pixels=observation.pixels * factor)
        torch.testing.assert_close(inlier_probability(scaled), expected, atol=1e-3, rtol=0)


@pytest.mark.parametrize("seen", ["sun beside the face"], indirect=True)
def test_what_is_clipped_goes_with_its_neighbours(seen):
    observation, there = painted(*seen, "sunglasses")
    few = torch.from_numpy(np.random.default_rng(0).random(len(there)) < 0.05)
    lost = replace(
        observation,
        pixels=torch.where(few[:, None], torch.tensor(1.0), observation.pixels),
        clipped=few,
    )
    inlier = inlier_probability(lost).numpy()
    # those at the rim have neighbours of both kinds
    assert (inlier[few.numpy() & ~there] > 0.5).mean() > 0.95
    assert (inlier[few.numpy() & there] < 0.5).mean() > 0.7


def test_without_evidence_neighbours_agree():
    """The mean field of two pixels: q = sigmoid(e + c (2 q' - 1)), solved by iteration here."""
    pair = skin_inliers._PixelGrid.of(torch.tensor([[3, 7], [4, 8]]))
    first, second = pair.mean_field(torch.tensor([3.0, -0.1], dtype=torch.float64)).tolist()
    coupling = skin_inliers.NEIGHBOURS
    sigmoid = lambda v: 1 / (1 + np.exp(-v))  # noqa: E731
    assert first == pytest.approx(sigmoid(3 + coupling * (2 * second - 1)), abs=1e-6)
    assert second == pytest.approx(sigmoid(-0.1 + coupling * (2 * first - 1)), abs=1e-6)
    assert second > 0.5
    apart = skin_inliers._PixelGrid.of(torch.tensor([[3, 7], [4, 9]]))
    alone = torch.tensor([3.0, -0.1], dtype=torch.float64)
    torch.testing.assert_close(apart.mean_field(alone), alone.sigmoid())
