import math

import pytest
import torch

from skylight.skies.surroundings._layer import Draws, View, rough_noise


def draws(count: int, seed: int = 0) -> Draws:
    return Draws(count=count, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("height", [8, 32, 64])
def test_cover_integrates_to_the_interval(height: int) -> None:
    view = View(height)
    low = draws(3).uniform((0.0, 0.7), view.parts)
    high = low + draws(3, seed=1).uniform((0.0, 0.8), view.parts)
    rows = view.between(low, high)
    assert ((rows >= 0) & (rows <= 1 + 1e-6)).all()
    step = math.pi / 2 / height
    torch.testing.assert_close(rows.sum(1) * step, high - low, rtol=0, atol=1e-5)
    assert not view.between(high, low).any()


def test_strips_keep_their_width_across_the_map_s_border() -> None:
    view = View(32)
    azimuth = torch.tensor([[0.3, math.pi, -math.pi + 1e-3]])
    half = torch.tensor([[1e-3, 0.02, 0.3]])
    cover = view.across(azimuth, half).sum(-1) * 2 * math.pi / view.parts
    torch.testing.assert_close(cover, 2 * half, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("rows", "columns", "roughness"), [(64, 256, 0.5), (1, 256, 1.5)])
def test_noise_has_mean_zero_and_variance_one(rows: int, columns: int, roughness: float) -> None:
    noise = rough_noise(draws(400), rows, columns, roughness)
    torch.testing.assert_close(noise.mean((1, 2)), torch.zeros(400), rtol=0, atol=1e-5)
    assert float(noise.square().mean()) == pytest.approx(1, abs=0.05)


def test_a_larger_map_has_the_same_texture() -> None:
    small, large = (View(height).texture(draws(4), 0.8) for height in (32, 64))
    averaged = large.unflatten(1, (32, 2)).mean(2).unflatten(2, (-1, 2)).mean(3)
    inner = slice(1, -1)  # the outermost rows are averaged with fewer neighbours
    error = (averaged - small)[:, inner].square().mean().sqrt()
    assert float(error) < 0.25 * float(small.std())
    seam = (small[..., 0] - small[..., -1]).square().mean()
    within = (small[..., 1] - small[..., 0]).square().mean()
    assert float(seam) < 4 * float(within)


def test_a_view_up_to_an_elevation_is_the_lower_part_of_the_whole() -> None:
    view = View(32)
    part = view.up_to(0.5)
    assert (part.rows - 1) * math.pi / 2 / 32 < 0.5 <= part.rows * math.pi / 2 / 32
    assert part.elevation.equal(view.elevation[-part.rows :])
    low, high = torch.zeros(1, view.parts), torch.full((1, view.parts), 0.5)
    whole = view.between(low, high)
    assert part.between(low, high).equal(whole[:, -part.rows :])
    assert not whole[:, : -part.rows].any()
    assert part.texture(draws(2), 0.8).equal(view.texture(draws(2), 0.8)[:, -part.rows :])
