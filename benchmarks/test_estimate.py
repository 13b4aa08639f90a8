"""Seconds of an estimate: its stages on a 512 x 512 photograph, and each light model alone."""

import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight._names import DEFAULT_LIGHT, DEFAULT_SKY, LIGHT_NAMES
from skylight.estimation._photos import STAGES, estimate_photo
from skylight.imaging._colour import srgb_to_linear
from skylight.imaging._photo import Photo
from skylight.inverse._estimate import estimate_light, light_problems
from skylight.inverse._problem import solve
from skylight.models._bundle import load_bundle
from skylight.skies._atmosphere import ClearSky
from skylight.skies._simulator import draw_day, simulate_sky, sunlit_moments
from skylight.transport._observation import Observation


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
    """Estimates made before, so that models are loaded and caches warm.

    The one that is given has a transport of 64 rows, which skies need; other light takes half.
    """
    estimate_photo(photo)
    return estimate_photo(photo, light="autoencoder")


@pytest.mark.parametrize("light", [DEFAULT_LIGHT, DEFAULT_SKY])
def test_estimate(benchmark, photo, estimated, light):
    """The default, and that of earlier versions."""
    result = benchmark.pedantic(estimate_photo, (photo,), {"light": light}, rounds=3)
    for stage in STAGES:
        benchmark.extra_info[stage] = result.seconds[stage]
    benchmark.extra_info["pixels"] = len(result.view.observation.pixels)


@pytest.mark.parametrize("light", LIGHT_NAMES)
def test_light_model(benchmark, estimated, light):
    benchmark.pedantic(estimate_light, (estimated.view.observation, light), rounds=2)


@pytest.fixture(scope="module", params=["cpu", "cuda"])
def device(request):
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    return request.param


@pytest.fixture(scope="module")
def eight(estimated):
    """The photograph's face eight times, each without another part of it."""
    whole = estimated.view.observation
    column = whole.places[:, 1]
    cuts = torch.linspace(0.05, 0.4, 8)
    return [_part(whole, column > column.float().quantile(cut)) for cut in cuts]


def _part(whole, kept):
    def rows(transport):
        return replace(transport, matrix=transport.matrix[kept])

    return Observation(
        pixels=whole.pixels[kept],
        weights=whole.weights[kept],
        places=whole.places[kept],
        transport=rows(whole.transport),
        specular=rows(whole.specular),
    )


@pytest.mark.benchmark(group="eight lights")
@pytest.mark.parametrize("light", ["sunsky", "autoencoder"])
def test_lights_one_by_one(benchmark, eight, light, device):
    def each():
        return [estimate_light(one, light, device=device) for one in eight]

    benchmark.pedantic(each, rounds=1)


@pytest.mark.benchmark(group="eight lights")
@pytest.mark.parametrize("light", ["sunsky", "autoencoder"])
def test_lights_as_one_batch(benchmark, eight, light, device):
    def together():
        skies = light_problems(light, len(eight), device=device)
        for sky, one in zip(skies, eight, strict=True):
            sky.add(one)
        return solve(skies)

    benchmark.pedantic(together, rounds=1)


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
    benchmark.extra_info["seconds_per_atmosphere"] = time.perf_counter() - start
    benchmark.pedantic(
        simulate_sky, (day, clear, *moments[len(moments) // 2]), {"height": 32}, rounds=3
    )
