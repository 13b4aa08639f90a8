import math
import re

import pytest
import torch

from skylight.errors import InputError
from skylight.models._bundle import load_bundle
from skylight.models._convolutional import LATENT, ConvolutionalAutoencoder
from skylight.models._network import CENTRE_AZIMUTH_RAD, HEIGHT, WIDTH, SkyNetwork
from skylight.models._splines import SplineAutoencoder
from skylight.models._sun_head import COORDINATES
from skylight.models.autoencoder import AutoencoderLight
from skylight.sphere._envmap import luminance, shift_columns
from skylight.sphere._frame import DirectionGrid, direction_from_angles

F64 = torch.float64


@pytest.fixture(scope="module", params=[SplineAutoencoder, ConvolutionalAutoencoder])
def light(request: pytest.FixtureRequest) -> AutoencoderLight:
    """The model round an untrained network: what it promises does not depend on training."""
    generator = torch.Generator().manual_seed(1)
    lower = torch.randn(LATENT, LATENT, generator=generator).tril(-1) * 0.05
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network: SkyNetwork = request.param()
    return AutoencoderLight(
        network,
        latent_mean=torch.randn(LATENT, generator=generator),
        latent_scale=lower + torch.eye(LATENT),
        bank=torch.randn(40, LATENT, generator=generator),
        bank_zenith_rad=torch.linspace(0.05, 1.5, 40),
        white_centroids=torch.randn(3, LATENT, generator=generator),
    )


def some_params(count: int = 2) -> torch.Tensor:
    return torch.randn(count, LATENT + 1, generator=torch.Generator().manual_seed(2))


def test_the_sun_has_its_own_coordinates(light: AutoencoderLight) -> None:
    """They change the lobe and not what the encoder's other latents are."""
    skies = torch.rand(2, HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(5))
    skies[:, 10, WIDTH // 2] = torch.tensor([[500.0], [900.0]])
    brighter = skies.clone()
    brighter[:, 10, WIDTH // 2] *= 2
    z, again = (light.network.encode(each) for each in (skies, brighter))
    torch.testing.assert_close(again[:, :-5], z[:, :-5], rtol=1e-4, atol=1e-4)
    # coordinates are (log E + 1) / 2: twice the light is half a log 2 more
    wanted = torch.full((2, 3), math.log(2) / 2)
    torch.testing.assert_close(again[:, -4:-1] - z[:, -4:-1], wanted, rtol=0.01, atol=0)
    column = light.network.decode(z).amax(dim=(1, 3)).argmax(1)
    assert column.tolist() == [WIDTH // 2] * 2


@pytest.mark.parametrize("spread", [0.0, 0.02])
def test_a_turn_by_whole_columns_rolls_them(light: AutoencoderLight, spread: float) -> None:
    z, azimuth = some_params()[:, :LATENT], torch.full((2,), CENTRE_AZIMUTH_RAD)
    ahead = light.network.decode_at_azimuth(z, azimuth, spread)
    turned = light.network.decode_at_azimuth(z, azimuth + 17 * 2 * math.pi / WIDTH, spread)
    if spread == 0:
        torch.testing.assert_close(ahead, light.network.decode(z), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(turned, torch.roll(ahead, 17, dims=2), rtol=1e-3, atol=1e-4)


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


@pytest.mark.parametrize("column", [10, 75, 120])
def test_a_sun_beside_the_centre_is_refused_and_how_to_turn_it_said(column: int) -> None:
    network = load_bundle().light().network
    sky = torch.full((2, HEIGHT, WIDTH, 3), 0.4)
    sky[0, 12, 64] = sky[1, 12, column] = 800.0
    side = "right" if column > 64 else "left"
    with pytest.raises(InputError, match=f"sky 1 stands {abs(column - 64)} columns {side}") as told:
        network.encode(sky)
    turn = re.search(r"turn the sky by (-?[\d.]+) rad", str(told.value))
    assert turn is not None
    network.encode(shift_columns(sky[1:], torch.tensor([float(turn[1])])))


def test_a_sky_without_a_sun_may_be_brightest_anywhere() -> None:
    sky = 1 + torch.rand(2, HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(0))
    sky[0, 20:23, 10:16] = 6.0  # a bright cloud
    load_bundle().light().network.encode(sky)
