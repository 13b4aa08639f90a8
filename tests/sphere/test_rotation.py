import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.sphere import _harmonics as harmonics
from skylight.sphere._rotation import (
    euler_angles,
    matrix_from_euler,
    rotate,
    rotation_blocks,
    wigner_small,
)
from tests.csc.thesis_gradients import sampled_bands, sampling_directions
from tests.oracles.wigner import small_d

F64 = torch.float64
POLES = [0.0, math.pi]

longitudes = st.floats(-math.pi, math.pi)
polar_angles = st.floats(0, math.pi)


def rotation(alpha: float, beta: float, gamma: float) -> torch.Tensor:
    return matrix_from_euler(*(torch.tensor(a, dtype=F64) for a in (alpha, beta, gamma)))


def random_coefficients(degree: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn((degree + 1) ** 2, generator=generator, dtype=F64)


def random_rotations(count: int, seed: int = 0) -> torch.Tensor:
    draw = torch.randn(count, 3, 3, generator=torch.Generator().manual_seed(seed), dtype=F64)
    q = torch.linalg.qr(draw).Q
    return q * torch.linalg.det(q)[:, None, None]


def signless(l: int, m: int) -> int:  # noqa: E741
    """What takes the Condon-Shortley sign away."""
    assert abs(m) <= l
    return -1 if m > 0 and m % 2 else 1


@pytest.mark.parametrize("beta", [*POLES, 0.3, 1.1, math.pi / 2, 2.9])
def test_wigner_closed_forms(beta: float) -> None:
    """Varshalovich et al. 1988, tables 4.4 and 4.6; else d_mn = (-1)^(m-n) d_nm = d_-n,-m."""
    c, s = math.cos(beta), math.sin(beta)
    tables = {
        1: {
            (1, 1): (1 + c) / 2,
            (1, 0): -s / math.sqrt(2),
            (1, -1): (1 - c) / 2,
            (0, 0): c,
        },
        2: {
            (2, 2): (1 + c) ** 2 / 4,
            (2, 1): -s * (1 + c) / 2,
            (2, 0): math.sqrt(6) / 4 * s * s,
            (2, -1): -s * (1 - c) / 2,
            (2, -2): (1 - c) ** 2 / 4,
            (1, 1): (2 * c * c + c - 1) / 2,
            (1, 0): -math.sqrt(3 / 2) * s * c,
            (1, -1): (1 + c - 2 * c * c) / 2,
            (0, 0): (3 * c * c - 1) / 2,
        },
    }
    bands = wigner_small(torch.tensor([beta], dtype=F64), 2)
    assert bands[0].item() == 1
    for l, table in tables.items():  # noqa: E741
        full = table.copy()
        for (m, n), value in table.items():
            full[n, m] = full[-m, -n] = (-1) ** (m - n) * value
            full[-n, -m] = value
        assert len(full) == (2 * l + 1) ** 2
        for (m, n), value in full.items():
            expected = signless(l, m) * value * signless(l, n)
            assert bands[l][0, l + m, l + n].item() == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("beta", [1e-3, 0.7, math.pi / 2, 3.0])
def test_wigner_agrees_with_the_exact_sum(beta: float) -> None:
    bands = wigner_small(torch.tensor([beta], dtype=F64), 40)
    for l in (3, 11, 40):  # noqa: E741
        for m in range(-l, l + 1, max(1, l // 5)):
            for n in range(-l, l + 1, max(1, l // 4)):
                expected = signless(l, m) * small_d(l, m, n, beta) * signless(l, n)
                assert bands[l][0, l + m, l + n].item() == pytest.approx(expected, abs=1e-13)


def test_wigner_is_unitary() -> None:
    beta = torch.tensor([*POLES, 1e-6, 0.4, math.pi / 2, 2.2, 3.14], dtype=F64)
    for d in wigner_small(beta, 100):  # of band 0 to 100
        eye = torch.eye(d.shape[1], dtype=F64).expand_as(d)
        torch.testing.assert_close(d @ d.mT, eye, atol=1e-12, rtol=0)


def test_wigner_at_the_poles() -> None:
    """d(0) = 1; d(pi) takes m to -m, with (-1)^l where the sign is left out."""
    for l, d in enumerate(wigner_small(torch.tensor(POLES, dtype=F64), 20)):  # noqa: E741
        eye = torch.eye(2 * l + 1, dtype=F64)
        torch.testing.assert_close(d[0], eye, atol=1e-14, rtol=0)
        torch.testing.assert_close(d[1].abs(), eye.flip(1), atol=1e-14, rtol=0)
        assert d[1, l, l].item() == pytest.approx((-1) ** l)


def test_wigner_gradients_poles_included() -> None:
    beta = torch.tensor([0.0, 0.3, 1.6, math.pi], dtype=F64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda b: tuple(wigner_small(b, 4)), beta)


@settings(max_examples=50)
@given(longitudes, polar_angles, longitudes)
def test_euler_angles_round_trip(alpha: float, beta: float, gamma: float) -> None:
    matrix = rotation(alpha, beta, gamma)
    torch.testing.assert_close(matrix @ matrix.T, torch.eye(3, dtype=F64), atol=1e-14, rtol=0)
    back = matrix_from_euler(*euler_angles(matrix))
    torch.testing.assert_close(back, matrix, atol=2e-9, rtol=0)  # within 1e-9 of a pole beta is it


@pytest.mark.parametrize("beta", POLES)
def test_euler_angles_at_the_poles(beta: float) -> None:
    alpha, back, gamma = euler_angles(rotation(0.4, beta, 0.3))
    assert gamma.item() == 0
    assert back.item() == pytest.approx(beta, abs=1e-12)
    assert alpha.item() == pytest.approx(0.7 if beta == 0 else 0.1)


def test_euler_angles_are_where_the_pole_goes() -> None:
    pole = rotation(0.5, 1.2, 0.9)[:, 2]
    expected = [math.sin(1.2) * math.cos(0.5), math.sin(1.2) * math.sin(0.5), math.cos(1.2)]
    torch.testing.assert_close(pole, torch.tensor(expected, dtype=F64))
    east = rotation(0.0, 0.0, 0.2)[:, 0]  # right-handed about +Z
    torch.testing.assert_close(east, torch.tensor([math.cos(0.2), math.sin(0.2), 0.0], dtype=F64))


@settings(max_examples=30)
@given(longitudes, polar_angles, longitudes)
def test_first_band_is_the_rotation_itself(alpha: float, beta: float, gamma: float) -> None:
    """Y_1m are y, z and x."""
    matrix, axes = rotation(alpha, beta, gamma), [1, 2, 0]
    block = rotation_blocks(matrix, 1)[1]
    torch.testing.assert_close(block, matrix[axes][:, axes], atol=2e-9, rtol=0)


@pytest.mark.parametrize("degree", [6, 40])
def test_blocks_compose_as_rotations_do(degree: int) -> None:
    first, second = random_rotations(2)
    both = rotation_blocks(first @ second, degree)
    pairs = zip(rotation_blocks(first, degree), rotation_blocks(second, degree), strict=True)
    for product, (a, b) in zip(both, pairs, strict=True):
        torch.testing.assert_close(a @ b, product, atol=1e-11, rtol=0)


def test_blocks_keep_leading_shapes() -> None:
    rotations = random_rotations(6)
    flat, folded = rotation_blocks(rotations, 3), rotation_blocks(rotations.reshape(2, 3, 3, 3), 3)
    for a, b in zip(flat, folded, strict=True):
        assert torch.equal(a.reshape(b.shape), b)


def test_recursion_and_sampling_agree() -> None:
    """D_l = M_l(R) M_l(I)^-1: two ways that share only the harmonics (thesis, Eq. C.3 to C.5)."""
    axes = sampling_directions(40)
    still = sampled_bands(axes, 40)
    for matrix in [*random_rotations(1, seed=3), rotation(0.3, math.pi, 0)]:
        turned = sampled_bands(axes @ matrix.T, 40)
        for block, s, t in zip(rotation_blocks(matrix, 40), still, turned, strict=True):
            sampled = torch.linalg.solve(s, t, left=False)
            torch.testing.assert_close(block, sampled, atol=1e-9, rtol=0)


@pytest.mark.parametrize(("beta", "degree"), [(0.0, 12), (1.3, 12), (1.3, 40), (math.pi, 12)])
def test_rotated_expansion_is_the_expansion_at_turned_back_directions(
    beta: float, degree: int
) -> None:
    """(R f)(w) = f(R^T w)."""
    matrix, coefficients = rotation(2.1, beta, -0.8), random_coefficients(degree)
    directions = random_rotations(30, seed=1)[:, 0]
    turned = harmonics.evaluate(directions, degree) @ rotate(coefficients, matrix)
    expected = harmonics.evaluate(directions @ matrix, degree) @ coefficients
    torch.testing.assert_close(turned, expected, atol=1e-11, rtol=0)


def test_rotating_many_expansions_is_rotating_each() -> None:
    matrix = random_rotations(1)[0]
    many = torch.stack([random_coefficients(5, seed) for seed in range(3)])
    each = torch.stack([rotate(one, matrix) for one in many])
    torch.testing.assert_close(rotate(many, matrix), each)
    assert rotate(many.float(), matrix).dtype == torch.float32
