import pytest
import torch

from skylight.sphere._envmap import LUMINANCE
from skylight.sphere._frame import DirectionGrid
from skylight.training._config import AutoencoderConfig
from skylight.training._skies import augment


def test_mirroring_keeps_the_sun_in_its_column() -> None:
    skies = torch.rand(8, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    plain, mirrored = (
        augment(skies, torch.Generator().manual_seed(1), AutoencoderConfig(mirror=mirror))
        for mirror in (False, True)
    )
    torch.testing.assert_close(mirrored[:, :, 64], plain[:, :, 64], rtol=0, atol=0)
    # column 64 + k of a mirrored sky is column 64 - k of the sky
    reflected = plain[:, :, (64 - (torch.arange(128) - 64)) % 128]
    flipped = [
        torch.equal(m, r) and not torch.equal(m, p)
        for m, r, p in zip(mirrored, reflected, plain, strict=True)
    ]
    kept = [torch.equal(m, p) for m, p in zip(mirrored, plain, strict=True)]
    assert all(a != b for a, b in zip(flipped, kept, strict=True))
    assert 0 < sum(flipped) < 8


def mean_luminance(skies: torch.Tensor) -> torch.Tensor:
    weight = DirectionGrid.sky(32).solid_angles.float() / (2 * torch.pi)
    return torch.einsum("n,bnc,c->b", weight, skies.flatten(1, 2), torch.tensor(LUMINANCE))


def test_every_sky_keeps_a_mean_of_one() -> None:
    skies = 3 * torch.rand(6, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    config = AutoencoderConfig(surroundings=1.0, tint=0.2)
    varied = augment(skies, torch.Generator().manual_seed(1), config)
    torch.testing.assert_close(mean_luminance(varied), torch.ones(6), rtol=1e-4, atol=0)
    assert (varied >= 0).all()


def test_tint_changes_colours_alone() -> None:
    skies = torch.rand(4, 32, 128, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    config = AutoencoderConfig(mirror=False, tint=0.2)
    varied = augment(skies, torch.Generator().manual_seed(1), config)
    gain = varied / skies
    torch.testing.assert_close(gain, gain[:, :1, :1].expand_as(gain), rtol=1e-4, atol=0)
    assert float((gain[:, 0, 0] / gain[:, 0, 0].mean(1, keepdim=True)).std()) > 0.05


@pytest.mark.parametrize("most", [0.4, 1.0])
def test_white_balance_goes_part_of_the_way_to_a_grey_mean(most: float) -> None:
    """The logs of the means' ratios shrink by a factor of their own, at least 1 - ``most``."""
    skies = torch.rand(40, 32, 128, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    skies = skies * torch.tensor([0.5, 1.0, 2.0])
    config = AutoencoderConfig(mirror=False, white_balance=most)
    varied = augment(skies, torch.Generator().manual_seed(1), config)
    solid = DirectionGrid.sky(32).solid_angles.float()
    before, after = (
        torch.einsum("n,bnc->bc", solid, s.flatten(1, 2)).log() for s in (skies, varied)
    )
    left = [(x[:, [0, 2]] - x[:, 1:2]) for x in (before, after)]
    share = left[1] / left[0]
    torch.testing.assert_close(share[:, 0], share[:, 1], rtol=1e-3, atol=1e-3)
    assert 1 - most - 1e-4 <= float(share.min()) < 1 - 0.8 * most
    assert 0.9 < float(share.max()) < 1 + 1e-4


def test_the_share_of_skies_with_surroundings_is_kept() -> None:
    skies = torch.ones(60, 32, 128, 3)
    config = AutoencoderConfig(mirror=False, surroundings=0.25)
    varied = augment(skies, torch.Generator().manual_seed(2), config)
    changed = (varied - 1).abs().amax(dim=(1, 2, 3)) > 0.01
    assert 0.1 < float(changed.float().mean()) < 0.4
