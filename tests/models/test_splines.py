import copy
import math

import pytest
import torch

from skylight.models._network import CENTRE_AZIMUTH_RAD, HEIGHT, WIDTH
from skylight.models._splines import FLOOR, SplineAutoencoder
from skylight.sphere._frame import DirectionGrid


@pytest.fixture(scope="module")
def network() -> SplineAutoencoder:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return SplineAutoencoder().eval()


def latents(count: int = 2) -> torch.Tensor:
    return torch.randn(count, 64, generator=torch.Generator().manual_seed(2))


def test_coded_and_back(network: SplineAutoencoder) -> None:
    radiance = torch.tensor([0.0, 1e-3, 1.0, 4e4]).reshape(1, 1, 4, 1).expand(1, 1, 4, 3).double()
    again = network.uncode(network.code(radiance))
    torch.testing.assert_close(again, radiance, rtol=1e-9, atol=1e-12)
    dark = network.uncode(torch.full((1, 3, 1, 1), math.log(FLOOR) - 1))
    assert float(dark.max()) == 0
    assert network.uncode(torch.full((1, 3, 1, 1), 1e4)).isfinite().all()


def test_training_and_fits_see_the_same_sky(network: SplineAutoencoder) -> None:
    """By sparse products, and by the control points about each direction."""
    z = latents(3)
    with torch.no_grad():
        turned = network.decode_at_azimuth(z, torch.full((1,), CENTRE_AZIMUTH_RAD), 0.0)
        torch.testing.assert_close(network.decode(z), turned, rtol=1e-5, atol=1e-5)
        each = network.decode_at_azimuth(z, torch.full((3,), CENTRE_AZIMUTH_RAD), 0.0)
        torch.testing.assert_close(each, turned, rtol=1e-6, atol=1e-6)


def test_gradients_of_training_are_those_of_fits(network: SplineAutoencoder) -> None:
    slopes = []
    for decode in (
        network.decode,
        lambda z: network.decode_at_azimuth(z, torch.tensor([CENTRE_AZIMUTH_RAD]), 0.0),
    ):
        z = latents().requires_grad_()
        slopes.append(torch.autograd.grad(decode(z).log1p().sum(), z)[0])
    torch.testing.assert_close(slopes[0], slopes[1], rtol=1e-4, atol=1e-4)


def test_gradients_come_after_inference_mode(network: SplineAutoencoder) -> None:
    """What networks share is made by whoever asks first."""
    with torch.inference_mode():
        network.decode_at_azimuth(latents(), torch.zeros(2), 0.02, 4)
    z = latents().requires_grad_(True)
    network.decode_at_azimuth(z, torch.zeros(2), 0.02, 4).sum().backward()
    assert z.grad is not None
    assert z.grad.abs().sum() > 0


def test_the_encoder_sees_the_best_coarse_splines(network: SplineAutoencoder) -> None:
    """What it sees is smooth already, so seeing the splines again changes nothing but a ridge."""
    coarse = torch.randn(len(network.seen), 2, generator=torch.Generator().manual_seed(0)).double()
    from skylight.models._splines import SEEN_ACROSS
    from skylight.sphere._lobes import DiskSplines

    matrix = DiskSplines(SEEN_ACROSS, DirectionGrid.sky(HEIGHT)).matrix()
    values = matrix @ coarse
    again = matrix @ (network.seen.double() @ values)
    assert float((again - values).square().mean().sqrt()) < 0.03 * float(values.std())


def test_it_can_be_copied_and_has_other_sizes(network: SplineAutoencoder) -> None:
    """torch copies no sparse tensor; the network holds none."""
    z = latents()
    assert torch.equal(copy.deepcopy(network).decode(z), network.decode(z))
    small = SplineAutoencoder(32)
    sky = torch.rand(1, HEIGHT, WIDTH, 3)
    assert small.encode(sky).shape == (1, 32)
    assert small.decode(small.encode(sky)).shape == (1, HEIGHT, WIDTH, 3)


def test_mixed_precision_decodes_in_single(network: SplineAutoencoder) -> None:
    """bfloat16's eight bits would round the brightness of the sky itself."""
    with torch.autocast("cpu", torch.bfloat16), torch.no_grad():
        coded = network.decode_coded(latents())
    assert coded.dtype == torch.float32
