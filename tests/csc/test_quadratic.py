import math
from dataclasses import dataclass

import pytest
import torch

from skylight.csc._active_set import LinearObservation, Quadratic, SampledSignal
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._latlong_transform import LatLongTransform

F64 = torch.float64
HEIGHT, DEGREE = 6, 4


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


@dataclass
class Case:
    """A quadratic, and A, W and x of the error that it stands for."""

    quadratic: Quadratic
    operator: torch.Tensor
    weights: torch.Tensor
    values: torch.Tensor


def case(kind: str) -> Case:
    grid = DirectionGrid.latlong(HEIGHT)
    basis = harmonics.evaluate_about_zenith(grid.directions, DEGREE)
    if kind == "matrix":
        operator, weights, values = random(40, 25), random(40, seed=1).abs(), random(40, 3, seed=2)
        return Case(LinearObservation.of(operator, values, weights), operator, weights, values)
    maps, pixels = random(HEIGHT, 2 * HEIGHT, 3), kind == "map and pixels"
    if pixels:
        basis = torch.cat([basis, torch.eye(len(basis), dtype=F64)], 1)
    signal = SampledSignal.of(maps, LatLongTransform(DEGREE, HEIGHT), pixels=pixels)
    return Case(signal, basis, grid.solid_angles, maps.reshape(-1, 3))


KINDS = ["matrix", "map", "map and pixels"]


@pytest.mark.parametrize("kind", KINDS)
def test_is_the_squared_error_of_each_colour(kind: str) -> None:
    """|x - A c|^2_W, in words."""
    it = case(kind)
    c = random(it.operator.shape[1], 3, seed=5)
    found = (
        it.quadratic.energy
        - 2 * (it.quadratic.target * c).sum(0)
        + (c * it.quadratic.hessian(c)).sum(0)
    )
    expected = it.weights @ (it.values - it.operator @ c).square()
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_hessian_and_target_are_what_the_operator_says(kind: str) -> None:
    it = case(kind)
    weighted = it.operator * it.weights[:, None]
    size = it.operator.shape[1]
    found = it.quadratic.hessian(torch.eye(size, dtype=F64))
    torch.testing.assert_close(found, it.operator.T @ weighted, rtol=0, atol=1e-12)
    torch.testing.assert_close(it.quadratic.target, weighted.T @ it.values, rtol=0, atol=1e-12)
    assert isinstance(it.quadratic, Quadratic)
    # one vector, and batches of any shape
    several = random(size, 2, 3, seed=6)
    images = it.quadratic.hessian(several)
    one = it.quadratic.hessian(several[:, 1, 2])
    torch.testing.assert_close(images[:, 1, 2], one, rtol=0, atol=1e-12)


def test_a_map_and_its_pixels_as_a_list_are_one_problem() -> None:
    maps, grid = random(HEIGHT, 2 * HEIGHT, 3), DirectionGrid.latlong(HEIGHT)
    signal = SampledSignal.of(maps, LatLongTransform(DEGREE, HEIGHT))
    basis = harmonics.evaluate_about_zenith(grid.directions, DEGREE)
    listed = LinearObservation.of(basis, maps.reshape(-1, 3), grid.solid_angles)
    c = random(25, 3, seed=1)
    torch.testing.assert_close(signal.target, listed.target, rtol=0, atol=1e-12)
    torch.testing.assert_close(signal.energy, listed.energy)
    torch.testing.assert_close(signal.hessian(c), listed.hessian(c), rtol=0, atol=1e-12)


def test_energy_of_a_constant_map() -> None:
    """4 pi L^2, and its target is L sqrt(4 pi) in the mean's place."""
    maps = torch.full((8, 16, 3), 2.5, dtype=F64)
    signal = SampledSignal.of(maps, LatLongTransform(3, 8))
    torch.testing.assert_close(
        signal.energy, torch.full((3,), 4 * math.pi * 6.25, dtype=F64), rtol=1e-12, atol=0
    )
    expected = torch.full((3,), 2.5 * math.sqrt(4 * math.pi), dtype=F64)
    torch.testing.assert_close(signal.target[0], expected, rtol=1e-12, atol=0)
