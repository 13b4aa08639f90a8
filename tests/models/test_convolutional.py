import math

import pytest
import torch
from hypothesis import given, settings, strategies as st
from torch.nn import functional

from skylight.models._convolutional import (
    LATENT,
    ConvolutionalAutoencoder,
    FoldedDecoder,
    UpConv,
    WrapConv,
)
from skylight.models._network import HEIGHT, WIDTH

F64 = torch.float64


def random_network(coding: str = "log", *, sun: bool = True) -> ConvolutionalAutoencoder:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return ConvolutionalAutoencoder(coding=coding, sun=sun).eval()  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [1, 3, 5, 7])
@pytest.mark.parametrize(("height", "width"), [(2, 8), (5, 7)])
def test_upsampling_convolution_is_what_it_replaces(size: int, height: int, width: int) -> None:
    layer = UpConv(3, 4, size).to(F64)
    x = torch.randn(2, 3, height, width, dtype=F64)
    slow = layer.reference(functional.interpolate(x, scale_factor=2, mode="nearest"))
    torch.testing.assert_close(layer(x), slow, rtol=1e-12, atol=1e-12)


def test_columns_wrap_and_rows_do_not() -> None:
    layer = WrapConv(2, 3, 5).to(F64)
    x = torch.randn(1, 2, 6, 12, dtype=F64)
    turned = torch.roll(layer(x), 5, dims=3)
    torch.testing.assert_close(layer(torch.roll(x, 5, dims=3)), turned, rtol=1e-12, atol=1e-12)
    assert not torch.allclose(layer(torch.roll(x, 1, dims=2)), torch.roll(layer(x), 1, dims=2))


@pytest.mark.parametrize(("sun", "latents"), [(False, 64), (True, 59)])
def test_layers_are_those_of_figure_5_2(sun: bool, latents: int) -> None:
    """(in, out, filter size) of every convolution, top to bottom; a linear output.

    With a sun head five of the 64 latents are its coordinates.
    """
    network = ConvolutionalAutoencoder(sun=sun)
    convolutions = [
        (m.in_channels, m.out_channels, m.kernel_size[0])
        for m in network.modules()
        if isinstance(m, torch.nn.Conv2d)
    ]
    assert convolutions == [
        *[(3, 64, 5), (64, 96, 3), (96, 96, 3), (96, 64, 3)],
        *[(64, 64, 3), (64, 96, 3), (96, 96, 3), (96, 64, 5)],
        (64, 3, 1),
    ]
    assert network.to_latent.out_features == latents
    assert network.from_latent[0].in_features == 64
    weights = sum(i * o * k * k for i, o, k in convolutions) + 3  # the output's bias
    dense = 1024 * latents + latents + 64 * 1024 + 1024
    normalisation = 2 * (64 + 96 + 96 + 64 + 1024 + 64 + 96 + 96 + 64)
    assert sum(p.numel() for p in network.parameters()) == weights + dense + normalisation


def test_resolutions_are_those_of_figure_5_2() -> None:
    network = random_network()
    sizes = []
    for module in network.modules():
        if isinstance(module, WrapConv):
            module.register_forward_hook(lambda _, x, __: sizes.append(tuple(x[0].shape[2:])))
    z = network.encode(torch.rand(2, HEIGHT, WIDTH, 3))
    assert sizes == [(32, 128), (16, 64), (8, 32), (4, 16)]
    assert z.shape == (2, 64)
    sky = network.decode(z)
    assert sky.shape == (2, HEIGHT, WIDTH, 3)
    assert (sky >= 0).all()


@pytest.mark.parametrize("sun", [True, False])
def test_the_folded_decoder_is_the_decoder(sun: bool) -> None:
    """To rounding, in float64, with batch statistics that are not those of the start."""
    network = random_network(sun=sun).to(F64)
    generator = torch.Generator().manual_seed(6)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            for tensor in (module.running_mean, module.running_var, module.weight, module.bias):
                shape = tensor.shape
                tensor.data = 0.5 + torch.rand(shape, generator=generator, dtype=F64)
    z = torch.randn(3, LATENT, generator=generator, dtype=F64)
    with torch.no_grad():
        expected, found = network.decode_coded(z), FoldedDecoder.of(network)(z)
    assert float(expected.std()) > 1e-3
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-10)
    # and so are its gradients, those of the normalisation included
    weights = [*network.from_latent.parameters(), *network.decoder.parameters()]
    slopes = [
        torch.autograd.grad(decode(z).square().sum(), weights)
        for decode in (network.decode_coded, FoldedDecoder.of(network))
    ]
    for one, other in zip(*slopes, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-8, atol=1e-8)


@settings(deadline=None)
@given(value=st.floats(0, 4e5), coding=st.sampled_from(["log", "linear"]))
def test_code_and_back(value: float, coding: str) -> None:
    network = ConvolutionalAutoencoder.__new__(ConvolutionalAutoencoder)
    torch.nn.Module.__init__(network)
    network.coding = coding  # type: ignore[assignment]
    radiance = torch.full((1, 1, 4, 3), value, dtype=F64)
    torch.testing.assert_close(
        network.uncode(network.code(radiance)), radiance, rtol=1e-9, atol=1e-9
    )


def test_uncoding_cuts_what_is_no_radiance() -> None:
    network = random_network()
    coded = torch.tensor([-1.0, 0.0, 1.0, 1e4]).reshape(1, 1, 1, 4).expand(1, 3, 1, 4)
    radiance = network.uncode(coded)[0, 0, :, 0]
    assert radiance[:2].tolist() == [0, 0]
    assert float(radiance[2]) == pytest.approx(math.e - 1, rel=1e-6)
    assert radiance.isfinite().all()
    # the limit is far above any sun: all of a clear sky's light within the disc, 6.8e-5 sr
    assert float(radiance[3]) > 4 * 2 * math.pi / 6.807e-5


@pytest.mark.parametrize("sun", [True, False])
def test_turning_keeps_every_rows_energy(sun: bool) -> None:
    network = random_network(sun=sun)
    z = torch.randn(2, LATENT, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        rows = [network.decode_at_azimuth(z, torch.full((2,), a), 0.0).sum(2) for a in (0.1, 0.877)]
    torch.testing.assert_close(rows[0], rows[1], rtol=1e-5, atol=1e-5)
