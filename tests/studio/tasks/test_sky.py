"""What the page makes skies of: the components of the prior, and the shipped decoder."""

import math
from importlib.resources import files

import httpx
import numpy as np
import pytest
import torch

from skylight.models._bundle import load_bundle
from skylight.models._network import CENTRE_AZIMUTH_RAD
from skylight.relight._decoder import SkyDecoder
from skylight.relight._export import BATCHES, TOLERANCE, decoder_difference
from skylight.studio.tasks._sky import describe_sky, latent_moments


def test_moments_are_those_of_samples() -> None:
    """As far as samples tell: of n, a mean is off by sqrt(C_ii / n), C by sqrt(tr(C)^2 / n)."""
    light, prior = load_bundle().light(), load_bundle().prior()
    mean, covariance = latent_moments(light, prior)
    count = 10_000
    white = prior.sample(count, torch.Generator().manual_seed(0))
    free = torch.cat([white, torch.zeros(count, 1)], 1)
    latents = light.from_free(free)[:, :-1].double()
    assert ((latents.mean(0) - mean).abs() < 5 * (covariance.diagonal() / count).sqrt()).all()
    # the squared norm of what a Gaussian's is off by: (tr(C)^2 + |C|^2) / n in the mean
    off = (torch.cov(latents.T) - covariance).norm()
    assert off < 2 * ((covariance.trace() ** 2 + covariance.norm() ** 2) / count).sqrt()


def test_components_are_axes_of_the_latents() -> None:
    sky = describe_sky(tell=lambda *_: None)
    axes, sigmas = np.array(sky["components"]), np.array(sky["sigmas"])
    _, covariance = latent_moments(load_bundle().light(), load_bundle().prior())
    assert np.allclose(axes @ axes.T, np.eye(8), atol=1e-9)
    assert np.allclose(axes @ covariance.numpy() @ axes.T, np.diag(sigmas**2), atol=1e-9)
    assert (np.diff(sigmas) < 0).all()
    assert np.allclose(sky["shares"], sigmas**2 / float(covariance.trace()))
    assert (axes[range(8), np.abs(axes).argmax(1)] > 0).all()


def seen(latent: torch.Tensor) -> dict[str, float]:
    """What people see of a sky whose sun is ahead: columns are azimuths, 64 of 128 the sun's."""
    height, red, green, blue, _ = latent[-5:].tolist()
    energy = [math.exp(min(2 * value - 1, 12)) for value in (red, green, blue)]
    sky = load_bundle().light()(torch.cat([latent, torch.zeros(1)])[None])[0].reshape(32, 128, 3)
    level = sky @ torch.tensor([0.2126, 0.7152, 0.0722])
    middle = level[6:28]
    behind = torch.cat([middle[:, :32], middle[:, 96:]], 1)
    return {
        "sun": float(np.dot(energy, (0.2126, 0.7152, 0.0722))),
        "sun's red over blue": energy[0] / energy[2],
        "sun's height": 90 - 90 / (1 + math.exp(-1.5 * height)),
        "red over blue": float(sky[..., 0].median() / sky[..., 2].median()),
        "contrast": float(level[4:20].log().std()),
        "zenith over horizon": float(level[:6].median() / level[26:].median()),
        "behind over ahead": float(behind.median() / middle[:, 32:96].median()),
        "right over left": float(middle[:, 64:].median() / middle[:, :64].median()),
    }


def test_a_component_does_what_it_is_called() -> None:
    """From -2 to 2 standard deviations, by a fifth at least of each quantity that its name says."""
    sky = describe_sky(tell=lambda *_: None)
    says: dict[str, dict[str, int]] = {
        "Clouds over the sun": {"sun": -1, "contrast": -1},
        "Lower, redder sun": {"sun's height": -1, "sun's red over blue": 1},
        "Bluer sky": {"red over blue": -1},
        "Warmer, smoother sky": {"red over blue": 1, "contrast": -1},
        "Evening sun": {"sun's height": -1, "sun's red over blue": 1, "sun": 1},
        "Brighter overhead": {"zenith over horizon": 1},
        "More even all round": {"behind over ahead": 1, "contrast": -1},
        "Brighter right of the sun": {"right over left": 1},
    }
    assert list(sky["names"]) == list(says)
    mean = torch.tensor(sky["mean"])
    for name, axis, sigma in zip(sky["names"], sky["components"], sky["sigmas"], strict=True):
        low, high = (seen(mean + steps * sigma * torch.tensor(axis)) for steps in (-2, 2))
        for quantity, sign in says[name].items():
            assert (high[quantity] / low[quantity]) ** sign > 1.2, (name, quantity)


def test_the_shipped_decoder_is_that_of_the_shipped_network() -> None:
    light = load_bundle().light()
    free = torch.randn(sum(BATCHES), 65, generator=torch.Generator().manual_seed(1))
    graph = (files("skylight.models") / "data" / "sky_decoder.onnx").read_bytes()
    latents = light.from_free(free)[:, :-1]
    assert decoder_difference(graph, light.network, latents) <= TOLERANCE
    # no word of the folders in which it was exported
    assert b"export.py" not in graph
    assert b"site-packages" not in graph


def test_the_page_gets_both(client: httpx.Client) -> None:
    sky = client.get("/api/sky.json").json()
    graph = client.get("/api/sky.onnx").content
    decoder = SkyDecoder(graph)
    assert decoder.centre_azimuth_rad == pytest.approx(CENTRE_AZIMUTH_RAD)
    assert decoder.centre_azimuth_rad == pytest.approx(math.pi / sky["columns"])
    radiance = decoder.decode(np.array([sky["mean"]], np.float32))
    assert radiance.shape == (1, sky["rows"], sky["columns"], 3)
    assert 0.2 < radiance.mean() < 5  # relative to a mean luminance of 1


def test_designs_are_those_that_jobs_take(client: httpx.Client) -> None:
    from skylight.probes.partitions._optimise import design_names

    told = client.get("/api/designs").json()
    assert [design["name"] for design in told["partitions"]] == design_names()
    assert [design["probe"] for design in told["voxel"]] == [1, 3, 5, 7]
