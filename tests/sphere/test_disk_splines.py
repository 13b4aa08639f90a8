import math

import numpy as np
import pytest
import torch
from scipy.interpolate import BSpline

from skylight.sphere._frame import DirectionGrid
from skylight.sphere._lobes import DiskSplines

F64 = torch.float64
GRID = DirectionGrid.sky(16)


def splines(across: int = 13) -> DiskSplines:
    return DiskSplines(across, GRID)


def lattice(across: int, made: DiskSplines) -> tuple[torch.Tensor, torch.Tensor]:
    """(x, y) of the numbered control points."""
    place = (torch.arange(across, dtype=F64) - 1) * 2 / (across - 3) - 1
    y, x = torch.meshgrid(place, place, indexing="ij")
    return x.flatten()[made.number >= 0], y.flatten()[made.number >= 0]


def on_disk(made: DiskSplines, turn: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    angle = made.azimuth_rad - turn
    return made.radius * angle.sin(), made.radius * angle.cos()


@pytest.mark.parametrize("across", [6, 13, 44])
def test_each_direction_has_sixteen_control_points_of_weight_one(across: int) -> None:
    made = splines(across)
    index, weights = made.taps(torch.tensor([0.3], dtype=F64))
    assert index.shape == (1, len(GRID), 16)
    assert (weights >= 0).all()
    torch.testing.assert_close(weights.sum(-1), torch.ones(1, len(GRID), dtype=F64))
    assert int(index.min()) >= 0  # none was left out
    assert int(index.max()) < made.count <= across**2


@pytest.mark.parametrize("turn", [0.0, 1.1, -3.0])
def test_linear_functions_are_reproduced(turn: float) -> None:
    """Cubic B-splines over control points a + b x + c y are a + b x + c y."""
    made = splines()
    x, y = lattice(13, made)
    control = (0.5 + 2 * x - 3 * y)[None, :, None]
    u, v = on_disk(made, turn)
    values = made(control, torch.tensor([turn], dtype=F64))
    torch.testing.assert_close(values[0, :, 0], 0.5 + 2 * u - 3 * v, rtol=1e-10, atol=1e-10)


def test_one_control_point_is_a_product_of_b_splines() -> None:
    """Against scipy's."""
    across, made = 13, splines()
    x, y = lattice(across, made)
    step = 2 / (across - 3)
    one = BSpline.basis_element(np.arange(-2, 3) * step, extrapolate=False)
    u, v = on_disk(made)
    for k in (0, made.count // 2, made.count - 1):
        control = torch.zeros(1, made.count, 1, dtype=F64)
        control[0, k] = 1
        found = made(control, torch.zeros(1, dtype=F64))[0, :, 0]
        parts = [np.nan_to_num(one((p - float(q[k])).numpy())) for p, q in ((u, x), (v, y))]
        np.testing.assert_allclose(found.numpy(), parts[0] * parts[1], atol=1e-12)


def test_each_function_has_its_turn_or_all_one() -> None:
    made = splines()
    control = torch.randn(3, made.count, 2, dtype=F64, generator=torch.Generator().manual_seed(0))
    turns = torch.tensor([0.2, -1.0, 2.5], dtype=F64)
    together = made(control, turns)
    for i in range(3):
        torch.testing.assert_close(together[i], made(control[i : i + 1], turns[i : i + 1])[0])
    torch.testing.assert_close(made(control, turns[:1])[2], made(control[2:], turns[:1])[0])


def test_a_turn_by_columns_is_exact() -> None:
    made = splines()
    control = torch.randn(1, made.count, 1, dtype=F64, generator=torch.Generator().manual_seed(0))
    ahead = made(control, torch.zeros(1, dtype=F64)).reshape(16, 64)
    turned = made(control, torch.full((1,), 5 * 2 * math.pi / 64, dtype=F64)).reshape(16, 64)
    torch.testing.assert_close(turned, ahead.roll(5, 1), rtol=1e-10, atol=1e-10)


def test_gradients_are_those_of_differences() -> None:
    made = DiskSplines(8, DirectionGrid.sky(4))
    control = torch.randn(2, made.count, 1, dtype=F64, generator=torch.Generator().manual_seed(0))
    turn = torch.tensor([0.31, -0.77], dtype=F64)
    assert torch.autograd.gradcheck(made, (control.requires_grad_(), turn.requires_grad_()))


def test_the_matrix_evaluates() -> None:
    made = splines()
    control = torch.randn(1, made.count, 2, dtype=F64, generator=torch.Generator().manual_seed(0))
    wanted = made(control, torch.zeros(1, dtype=F64))[0]
    torch.testing.assert_close(made.matrix() @ control[0], wanted)


def test_bilinear_samples_are_the_sixteen_control_points() -> None:
    """In single precision too, wherever in their cells the directions lie."""
    made = DiskSplines(44, DirectionGrid.sky(32))
    control = torch.randn(2, made.count, 3, generator=torch.Generator().manual_seed(0))
    for turn in (0.0, 0.123, -2.0):
        turns = torch.tensor([turn])
        torch.testing.assert_close(
            made(control, turns), made.gathered(control, turns), rtol=1e-4, atol=2e-5
        )
