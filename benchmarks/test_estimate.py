"""Seconds of an estimate: its stages on a 512 x 512 photograph, and each light model alone."""

import time

import numpy as np
import pytest
import torch

from skylight.app.estimate.photos import STAGES, estimate_photo
from skylight.imaging.colour import srgb_to_linear
from skylight.imaging.photo import Photo
from skylight.inverse.estimate import estimate_light
from skylight.models.bundle import load_bundle
from skylight.models.names import LIGHT_NAMES
from skylight.skies.atmosphere import ClearSky
from skylight.skies.simulator import draw_day, simulate_sky, sunlit_moments


@pytest.fixture(scope="module")
def photo():
    data = pytest.importorskip("skimage.data")
    encoded = np.ascontiguousarray(data.astronaut())
    return Photo(
        pixels=srgb_to_linear(torch.from_numpy(encoded).float() / 255),
        clipped=torch.from_numpy((encoded == 255).any(2)),
        encoded=encoded,
        focal_px=None,
    )


@pytest.fixture(scope="module")
def estimated(photo):
    """An estimate made before, so that models are loaded and caches warm."""
    return estimate_photo(photo)


def test_estimate(benchmark, photo, estimated):
    result = benchmark.pedantic(estimate_photo, (photo,), rounds=2)
    for stage in STAGES:
        benchmark.extra_info[stage] = result.seconds[stage]
    benchmark.extra_info["pixels"] = len(result.view.observation.pixels)


@pytest.mark.parametrize("light", LIGHT_NAMES)
def test_light_model(benchmark, estimated, light):
    benchmark.pedantic(estimate_light, (estimated.view.observation, light), rounds=2)


@pytest.mark.parametrize("batch", [1, 8])
def test_decoder_forward_and_backward(benchmark, batch):
    model = load_bundle().light()
    params = model.starts()[torch.arange(batch) % len(model.starts())].clone().requires_grad_()

    def step():
        (slope,) = torch.autograd.grad(model(params).sum(), params)
        return slope

    benchmark(step)


def test_sky_simulation(benchmark):
    day = draw_day(0)
    clear = ClearSky(day.atmosphere)
    moments = sunlit_moments(day, interval_min=60.0)
    start = time.perf_counter()
    ClearSky(day.atmosphere)
    benchmark.extra_info["seconds_per_day_of_tables"] = time.perf_counter() - start
    benchmark.pedantic(
        simulate_sky, (day, clear, *moments[len(moments) // 2]), {"height": 32}, rounds=3
    )
