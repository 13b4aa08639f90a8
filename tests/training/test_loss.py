from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.training._autoencoder import reconstruction_loss
from skylight.training._config import AutoencoderConfig
from skylight.training._skies import Corruption, draw_corruption


def skies() -> tuple[np.ndarray, np.ndarray]:
    true, predicted = np.random.default_rng(0).exponential(2.0, (2, 3, 32, 128, 3))
    return true, predicted


def loss_of(predicted: np.ndarray, true: np.ndarray, config: AutoencoderConfig) -> np.ndarray:
    """The loss of a network that decodes ``predicted``, whatever it is given."""
    network = ConvolutionalAutoencoder(sun=False)
    coded = torch.tensor(np.log1p(predicted)).permute(0, 3, 1, 2).float()
    network.decode_coded = lambda z: coded  # type: ignore[method-assign]
    with torch.no_grad():
        return loss_of_sky(network, torch.tensor(true).float(), config).numpy()


def loss_of_sky(
    network: ConvolutionalAutoencoder,
    sky: torch.Tensor,
    config: AutoencoderConfig,
    corruption: Corruption | None = None,
) -> torch.Tensor:
    sun, rest = network.split(sky)
    return reconstruction_loss(network, sun, network.code(rest), config, corruption)


@pytest.mark.parametrize("energy_weight", [0.0, 0.3])
@pytest.mark.parametrize("scale_invariant", [0.0, 2.0])
@pytest.mark.parametrize("squared_weight", [0.0, 0.7])
def test_loss_is_its_formula(
    energy_weight: float, scale_invariant: float, squared_weight: float
) -> None:
    true, predicted = skies()
    config = AutoencoderConfig(
        energy_weight=energy_weight, scale_invariant=scale_invariant, squared_weight=squared_weight
    )
    edges = np.cos(np.linspace(0, np.pi / 2, 33))
    row = (edges[:-1] - edges[1:]) * 2 * np.pi / 128
    share = np.broadcast_to(row[None, :, None, None] / (2 * np.pi) / 3, true.shape)
    d = np.log1p(predicted) - np.log1p(true)
    each = (1 + energy_weight * np.maximum(true, predicted)) * np.abs(d) + squared_weight * d**2
    axes = (1, 2, 3)
    spread = (share * d**2).sum(axes) - (share * d).sum(axes) ** 2
    expected = (share * each).sum(axes) + scale_invariant * spread
    np.testing.assert_allclose(loss_of(predicted, true, config), expected, rtol=1e-5)


def test_loss_of_the_truth_is_zero() -> None:
    true, _ = skies()
    np.testing.assert_allclose(loss_of(true, true, AutoencoderConfig()), 0, atol=1e-6)


def test_the_second_part_forgives_exposure_and_nothing_else() -> None:
    true, _ = skies()
    brighter = np.expm1(np.log1p(true) + 0.3)
    plain, forgiving = (
        loss_of(brighter, true, AutoencoderConfig(energy_weight=0.0, scale_invariant=s))
        for s in (0.0, 5.0)
    )
    np.testing.assert_allclose(plain, 0.3, rtol=1e-4)
    np.testing.assert_allclose(forgiving, plain, atol=1e-5)


def test_a_sun_with_its_own_head_is_not_the_networks_concern() -> None:
    """The same loss whatever the sun's strength, but for its coordinates in the decoder."""
    network = ConvolutionalAutoencoder(sun=True)
    seen = []
    coded = torch.zeros(1, 3, 32, 128)
    network.decode_coded = lambda z: seen.append(z) or coded  # type: ignore[method-assign]
    losses = []
    for strength in (1e2, 1e4):
        sky = torch.full((1, 32, 128, 3), 0.5)
        sky[:, 9, 64] = strength
        losses.append(float(loss_of_sky(network, sky, AutoencoderConfig())))
    assert losses[0] == pytest.approx(losses[1], rel=1e-6)
    assert not torch.allclose(seen[0][:, -5:], seen[1][:, -5:])


def corrupted(config: AutoencoderConfig) -> Corruption:
    return draw_corruption(3, (32, 128), torch.Generator().manual_seed(1), config)


@pytest.mark.parametrize(
    "config",
    [
        AutoencoderConfig(noise_sigma=0.1),
        AutoencoderConfig(noise_sigma=0.0, masked=0.3),
        AutoencoderConfig(noise_sigma=0.0, sun_noise=0.1),
    ],
)
def test_the_encoder_sees_the_corruption_and_the_loss_does_not(config: AutoencoderConfig) -> None:
    network = ConvolutionalAutoencoder(sun=True).eval()
    seen = []
    coded = torch.zeros(3, 3, 32, 128)
    network.encode_coded = lambda *parts: seen.append(parts) or torch.zeros(3, 64)  # type: ignore
    network.decode_coded = lambda z: coded  # type: ignore[method-assign]
    sky = torch.rand(3, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    corruption = corrupted(config)
    losses = [loss_of_sky(network, sky, config, c) for c in (None, corruption)]
    torch.testing.assert_close(losses[0], losses[1], rtol=0, atol=0)
    (sun, clean), (shaken, dirty) = seen
    torch.testing.assert_close(dirty, corruption.kept * (clean + corruption.noise))
    torch.testing.assert_close(shaken, sun + corruption.sun)
    assert not (torch.equal(dirty, clean) and torch.equal(shaken, sun))


def test_the_second_part_counts_contrast() -> None:
    """An error of the same mean and size, but of both signs, is not forgiven."""
    true, _ = skies()
    sign = np.where(np.arange(128) % 2, 1.0, -1.0)[None, None, :, None]
    contrasted = np.expm1(np.maximum(np.log1p(true) + 0.3 * sign, 0))
    plain, forgiving = (
        loss_of(contrasted, true, AutoencoderConfig(energy_weight=0.0, scale_invariant=s))
        for s in (0.0, 5.0)
    )
    assert (forgiving > plain + 5 * 0.05).all()


def test_noise_and_penalty_are_of_the_latents_but_the_suns() -> None:
    network = ConvolutionalAutoencoder(sun=True).eval()
    seen = []
    coded = torch.zeros(3, 3, 32, 128)
    latents = torch.arange(64.0).expand(3, -1)
    network.encode_coded = lambda *_: latents  # type: ignore[method-assign]
    network.decode_coded = lambda z: seen.append(z) or coded  # type: ignore[method-assign]
    sky = torch.rand(3, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    plain = AutoencoderConfig(latent_noise=0.5, sun_noise=0.0)
    drawn = corrupted(plain)
    losses = [
        loss_of_sky(network, sky, replace(plain, latent_penalty=p), drawn) for p in (0.0, 0.1)
    ]
    torch.testing.assert_close(seen[0][:, :59], latents[:, :59] + drawn.latents)
    assert 0.3 < float(drawn.latents.std()) < 0.7
    assert torch.equal(seen[0][:, 59:], latents[:, 59:])
    wanted = 0.1 * latents[:, :59].square().mean(1)
    torch.testing.assert_close(losses[1] - losses[0], wanted, rtol=1e-4, atol=0)
