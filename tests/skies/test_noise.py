import math

import pytest
import torch

from skylight.skies._clouds import CELLS, fractal_noise


def places(count: int) -> torch.Tensor:
    return 50 * torch.rand(count, 3, generator=torch.Generator().manual_seed(0))


def test_values_are_uniform() -> None:
    value = fractal_noise(places(100_000))
    assert float(value.min()) >= 0
    assert float(value.max()) <= 1
    for q in (0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98):
        assert float((value < q).float().mean()) == pytest.approx(q, abs=0.03)


def test_the_tile_repeats_without_a_seam() -> None:
    p = places(2_000)
    torch.testing.assert_close(fractal_noise(p + CELLS), fractal_noise(p), rtol=0, atol=2e-3)
    step = 1e-3
    across = torch.tensor([[0.0, 3.3, 7.7]]).expand(3, 3).clone()
    for axis in range(3):
        across[axis, axis] = CELLS - step / 2
    jump = fractal_noise(across + step * torch.eye(3)) - fractal_noise(across)
    assert float(jump.abs().max()) < 0.02


def test_it_is_smooth_and_random() -> None:
    p = places(5_000)
    assert float((fractal_noise(p + 0.01) - fractal_noise(p)).abs().max()) < 0.12
    # a few cells apart values know nothing of each other
    far = torch.corrcoef(
        torch.stack([fractal_noise(p), fractal_noise(p + torch.tensor([5.5, 0.0, 3.1]))])
    )[0, 1]
    assert abs(float(far)) < 0.1
    near = torch.corrcoef(torch.stack([fractal_noise(p), fractal_noise(p + 0.1)]))[0, 1]
    assert float(near) > 1 - 10 * 0.1**2 * math.pi
