import math

import pytest
import torch

from skylight.skies.noise import CELLS, swell


def places(count: int) -> torch.Tensor:
    return 50 * torch.rand(count, 3, generator=torch.Generator().manual_seed(0))


def test_values_are_uniform() -> None:
    value = swell(places(100_000))
    assert float(value.min()) >= 0
    assert float(value.max()) <= 1
    for q in (0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98):
        assert float((value < q).float().mean()) == pytest.approx(q, abs=0.03)


def test_the_tile_repeats_without_a_seam() -> None:
    p = places(2_000)
    torch.testing.assert_close(swell(p + CELLS), swell(p), rtol=0, atol=2e-3)
    step = 1e-3
    across = torch.tensor([[0.0, 3.3, 7.7]]).expand(3, 3).clone()
    for axis in range(3):
        across[axis, axis] = CELLS - step / 2
    jump = swell(across + step * torch.eye(3)) - swell(across)
    assert float(jump.abs().max()) < 0.02


def test_it_is_smooth_and_random() -> None:
    p = places(5_000)
    assert float((swell(p + 0.01) - swell(p)).abs().max()) < 0.12
    # a few cells apart values know nothing of each other
    far = torch.corrcoef(torch.stack([swell(p), swell(p + torch.tensor([5.5, 0.0, 3.1]))]))[0, 1]
    assert abs(float(far)) < 0.1
    near = torch.corrcoef(torch.stack([swell(p), swell(p + 0.1)]))[0, 1]
    assert float(near) > 1 - 10 * 0.1**2 * math.pi
