import math
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file
from torch.nn import functional

from skylight.errors import AssetError
from skylight.io.tensors import read_tensors, write_tensors
from skylight.models.autoencoder import (
    CENTRE_AZIMUTH_RAD,
    HEIGHT,
    LATENT,
    WIDTH,
    AutoencoderLight,
    FoldedDecoder,
    SkyAutoencoder,
    UpConv,
    WrapConv,
    load_network,
    save_network,
)
from skylight.models.bundle import load_bundle
from skylight.models.sun_head import COORDINATES
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import direction_from_angles
from skylight.sphere.grid import DirectionGrid

F64 = torch.float64


def random_network(coding: str = "log", *, sun: bool = True) -> SkyAutoencoder:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return SkyAutoencoder(coding, sun=sun).eval()  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def light() -> AutoencoderLight:
    """The model round an untrained network: what it promises does not depend on training."""
    generator = torch.Generator().manual_seed(1)
    lower = torch.randn(LATENT, LATENT, generator=generator).tril(-1) * 0.05
    return AutoencoderLight(
        random_network(),
        latent_mean=torch.randn(LATENT, generator=generator),
        latent_scale=lower + torch.eye(LATENT),
        bank=torch.randn(40, LATENT, generator=generator),
        bank_zenith_rad=torch.linspace(0.05, 1.5, 40),
        white_centroids=torch.randn(3, LATENT, generator=generator),
    )


def some_params(count: int = 2) -> torch.Tensor:
    return torch.randn(count, LATENT + 1, generator=torch.Generator().manual_seed(2))


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
    network = SkyAutoencoder(sun=sun)
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


def test_the_sun_has_its_own_coordinates() -> None:
    """They change the lobe and not what the encoder's other latents are."""
    network = random_network()
    generator = torch.Generator().manual_seed(5)
    skies = torch.rand(2, HEIGHT, WIDTH, 3, generator=generator)
    skies[:, 10, WIDTH // 2] = torch.tensor([[500.0], [900.0]])
    z = network.encode(skies)
    brighter = skies.clone()
    brighter[:, 10, WIDTH // 2] *= 2
    again = network.encode(brighter)
    torch.testing.assert_close(again[:, :-5], z[:, :-5], rtol=1e-5, atol=1e-5)
    # coordinates are (log E + 1) / 2: twice the light is half a log 2 more
    torch.testing.assert_close(
        again[:, -4:-1] - z[:, -4:-1], torch.full((2, 3), math.log(2) / 2), rtol=0.01, atol=0
    )
    decoded = network.decode(z)
    column = decoded.amax(dim=(1, 3)).argmax(1)
    assert column.tolist() == [WIDTH // 2] * 2


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
    network = SkyAutoencoder.__new__(SkyAutoencoder)
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


def test_azimuth_turns_the_sky(light: AutoencoderLight) -> None:
    params = some_params()
    params[:, LATENT] = CENTRE_AZIMUTH_RAD
    ahead = light(params).reshape(2, HEIGHT, WIDTH, 3)
    decoded = light.network.decode(params[:, :LATENT])
    torch.testing.assert_close(ahead, decoded, rtol=1e-4, atol=1e-4)
    params[:, LATENT] += 17 * 2 * math.pi / WIDTH
    turned = light(params).reshape(2, HEIGHT, WIDTH, 3)
    torch.testing.assert_close(turned, torch.roll(ahead, 17, dims=2), rtol=1e-3, atol=1e-4)


def test_turning_keeps_every_rows_energy(light: AutoencoderLight) -> None:
    params = some_params()
    other = params.clone()
    other[:, LATENT] += 0.777
    rows = [light(p).reshape(2, HEIGHT, WIDTH, 3).sum(2) for p in (params, other)]
    torch.testing.assert_close(rows[0], rows[1], rtol=1e-5, atol=1e-5)


def test_free_and_back(light: AutoencoderLight) -> None:
    params = 3 * some_params(5)
    torch.testing.assert_close(light.from_free(light.to_free(params)), params, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(light.to_free(light.from_free(params)), params, rtol=1e-4, atol=1e-4)
    assert torch.equal(light.to_free(params)[:, LATENT], params[:, LATENT])


def test_free_side_is_white(light: AutoencoderLight) -> None:
    """White free parameters become latents of the given mean and covariance L L^T."""
    free = torch.randn(20_000, LATENT + 1, generator=torch.Generator().manual_seed(3))
    latents = light.from_free(free)[:, :LATENT]
    torch.testing.assert_close(latents.mean(0), light.latent_mean, rtol=0, atol=0.05)
    wanted = light.latent_scale @ light.latent_scale.T
    torch.testing.assert_close(torch.cov(latents.T), wanted, rtol=0, atol=0.07)


def test_starts_take_the_banks_suns_of_that_height(light: AutoencoderLight) -> None:
    zenith = torch.tensor([0.3, 1.2])
    starts = light.starts_towards(direction_from_angles(torch.tensor([0.5, -2.0]), zenith))
    assert starts.shape == (2, light.candidates, LATENT + 1)
    torch.testing.assert_close(starts[..., LATENT], torch.tensor([[0.5], [-2.0]]).expand(2, 6))
    for row, wanted in zip(starts, zenith, strict=True):
        used = [int((light.bank == s[:LATENT]).all(1).nonzero()) for s in row]
        assert len(set(used)) == light.candidates
        far = (light.bank_zenith_rad - wanted).abs()
        assert float(far[used].max()) <= float(far.sort().values[light.candidates - 1])


def test_starts_are_the_centroids(light: AutoencoderLight) -> None:
    free = light.to_free(light.starts())
    torch.testing.assert_close(free[:, :LATENT], light.white_centroids, rtol=1e-4, atol=1e-4)
    assert (free[:, LATENT] == 0).all()


def test_the_network_stays_as_it_was_trained(light: AutoencoderLight) -> None:
    assert not light.network.training
    assert not any(p.requires_grad for p in light.parameters())
    params = some_params().requires_grad_()
    (gradient,) = torch.autograd.grad(luminance(light(params)).sum(), params)
    assert gradient.isfinite().all()


@pytest.mark.parametrize("sun", [True, False])
@pytest.mark.parametrize("coding", ["log", "linear"])
def test_saved_and_loaded(tmp_path: Path, coding: str, sun: bool) -> None:
    network = random_network(coding, sun=sun)
    save_network(network, tmp_path / "model.safetensors")
    loaded = load_network(tmp_path / "model.safetensors")
    assert (loaded.coding, loaded.sun) == (coding, sun)
    assert not loaded.training
    z = torch.randn(2, LATENT)
    assert torch.equal(loaded.decode(z), network.decode(z))


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _drop_one(path: Path) -> None:
    state, _ = read_tensors(path)
    state.pop("output.weight")
    write_tensors(path, state)


def _misshape(path: Path) -> None:
    write_tensors(path, read_tensors(path)[0] | {"output.weight": torch.zeros(2, 2)})


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    "damage",
    [
        Path.unlink,
        _truncate,
        _drop_one,
        _misshape,
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("not a checkpoint"),
        _flip,
        lambda path: write_tensors(path, {"x": torch.zeros(1)}),
        lambda path: save_file({"x": torch.zeros(1)}, path),
    ],
)
def test_unusable_checkpoints(tmp_path: Path, damage) -> None:
    path = tmp_path / "model.safetensors"
    save_network(random_network(), path)
    damage(path)
    with pytest.raises(AssetError) as caught:
        load_network(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    assert "train.py" in message


def test_a_spread_sun_moves_smoothly_and_keeps_its_energy() -> None:
    spread = math.radians(1.4)
    smooth, sharp = load_bundle().light(sun_spread_rad=spread), load_bundle().light()
    params = smooth.starts_towards(torch.tensor([[0.4, 0.6, -0.7]], dtype=F64))[0, :1].float()
    steps = torch.linspace(-0.5, 0.5, 11) * 2 * math.pi / WIDTH  # over one pixel
    turned = params.expand(len(steps), -1).clone()
    turned[:, LATENT] += steps
    grid = DirectionGrid.sky(HEIGHT)

    def suns(light: AutoencoderLight) -> tuple[torch.Tensor, torch.Tensor]:
        """(the brightest pixel's share of the light, all light) at each step."""
        energy = luminance(light(turned)).double() * grid.solid_angles
        return energy.amax(1) / energy.sum(1), energy.sum(1)

    (share, total), (sharp_share, sharp_total) = suns(smooth), suns(sharp)
    torch.testing.assert_close(total, sharp_total, rtol=1e-3, atol=0.0)
    # a sharp sun between two pixels is torn in halves; a spread one hardly changes
    assert float(share.amax() / share.amin()) < 1.5 < float(sharp_share.amax() / sharp_share.amin())
    energy = luminance(smooth(turned)).double() * grid.solid_angles
    near = grid.directions @ direction_from_angles(*sun_angles(params)) > math.cos(0.15)
    middle = (energy * near) @ grid.directions
    azimuth = torch.atan2(middle[:, 0], -middle[:, 2]).float()
    torch.testing.assert_close(azimuth.diff(), steps.diff(), rtol=0.2, atol=0.0)


def sun_angles(params: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(azimuth, zenith angle) of the sun of one set of parameters."""
    zenith = math.pi / 2 * torch.sigmoid(1.5 * params[0, LATENT - COORDINATES].double())
    return params[0, LATENT].double(), zenith
