"""One sky out of its latents, and its gradient: the networks that ship and that the thesis has."""

import math

import pytest
import torch

from skylight.models._bundle import load_bundle
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.models._network import CENTRE_AZIMUTH_RAD, SkyNetwork

AZIMUTH = torch.tensor([CENTRE_AZIMUTH_RAD])
SPREAD_RAD = math.radians(1.4)


@pytest.fixture(scope="module", params=["splines", "convolutions"])
def network(request) -> SkyNetwork:
    found = load_bundle().network if request.param == "splines" else ConvolutionalAutoencoder()
    return found.eval().requires_grad_(False)


@pytest.mark.parametrize("skies", [1, 16])
def test_forward_and_backward(benchmark, network, skies):
    z = torch.zeros(skies, network.latents, requires_grad=True)

    def gradient():
        z.grad = None
        network.decode_at_azimuth(z, AZIMUTH, SPREAD_RAD).sum().backward()

    benchmark(gradient)


@pytest.mark.parametrize("rows", [32, 64])
def test_forward(benchmark, network, rows):
    z = torch.zeros(1, network.latents)
    with torch.no_grad():
        benchmark(network.turned, z, AZIMUTH, SPREAD_RAD, rows)
