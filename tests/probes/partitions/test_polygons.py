"""Closed forms over spherical Voronoi polygons against known values and a fine quadrature."""

import math

import pytest
import torch
from hypothesis import given, settings, strategies as st
from scipy.integrate import lebedev_rule
from torch import Tensor

from skylight.probes.partitions._cells import voronoi
from skylight.sphere._frame import DirectionGrid, rotation_about

CUBE = torch.cat([torch.eye(3), -torch.eye(3)]).double()


def random_directions(count: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return values / values.norm(dim=1, keepdim=True)


def form_factor_of_square() -> float:
    """From a point at distance 1 to a square of side 2 facing it (Siegel and Howell, B.3), pi F:
    four quarters of 2 x / sqrt(1 + x^2) atan(y / sqrt(1 + x^2)) / 2 pi with x = y = 1."""
    return 4 * math.atan(1 / math.sqrt(2)) / math.sqrt(2)


def test_cube_faces_have_the_form_factors_of_a_box() -> None:
    gathered = voronoi(CUBE).clamped_cosine(CUBE)
    front = form_factor_of_square()
    side = (math.pi - front) / 4
    expected = torch.full((6, 6), side, dtype=torch.float64)
    for i in range(6):
        expected[i, i] = front
        expected[i, (i + 3) % 6] = 0
    torch.testing.assert_close(gathered, expected, rtol=0, atol=1e-14)


def test_octants_give_a_quarter_of_pi() -> None:
    """int over x, y, z > 0 of z dw = pi / 4, and pi / 2 of area each."""
    corners = torch.cartesian_prod(*[torch.tensor([1.0, -1.0])] * 3).double() / math.sqrt(3)
    octants = voronoi(corners)
    areas = octants.solid_angles()
    torch.testing.assert_close(areas, torch.full_like(areas, math.pi / 2), rtol=0, atol=1e-14)
    gathered = octants.clamped_cosine(CUBE[:3])
    expected = (corners.T > 0).double() * math.pi / 4
    # horizons run along the octants' own borders
    torch.testing.assert_close(gathered, expected, rtol=0, atol=1e-14)
    assert len(octants.vertices) == 6, "Qhull's doubled vertices are one"
    assert len(octants.starts) == 12


@pytest.mark.parametrize("degree", [5, 17])
def test_symmetric_sets_are_closed(degree: int) -> None:
    seeds = torch.from_numpy(lebedev_rule(degree)[0].T.copy())
    diagram = voronoi(seeds)
    assert len(diagram.vertices) - len(diagram.starts) + len(seeds) == 2, "Euler"
    assert abs(float(diagram.solid_angles().sum()) - 4 * math.pi) < 1e-12
    assert float(diagram.vector_integrals().sum(0).norm()) < 1e-12
    normals = torch.cat([seeds, diagram.vertices, random_directions(300, 0)])
    gathered = diagram.clamped_cosine(normals)
    assert float((gathered.sum(1) - math.pi).abs().max()) < 1e-12
    assert float(gathered.min()) >= 0


@given(st.integers(6, 60), st.integers(0, 10**6))
@settings(max_examples=15)
def test_random_sets_sum_to_the_whole(count: int, seed: int) -> None:
    seeds = torch.cat([CUBE, random_directions(count, seed)])
    diagram = voronoi(seeds)
    assert abs(float(diagram.solid_angles().sum()) - 4 * math.pi) < 1e-12
    gathered = diagram.clamped_cosine(random_directions(50, seed + 1))
    assert float((gathered.sum(1) - math.pi).abs().max()) < 1e-11


def test_a_fine_quadrature_agrees() -> None:
    seeds = torch.cat([CUBE, random_directions(15, 3)])
    diagram = voronoi(seeds)
    grid = DirectionGrid.hammersley(400_000)
    normals = torch.cat([random_directions(12, 4), diagram.vertices[:2], diagram.poles[:2]])
    cosine = (normals @ grid.directions.T).clamp(min=0) * grid.solid_angles
    nearest = (grid.directions @ seeds.T).argmax(1)
    sums = torch.zeros(len(normals), len(seeds)).double().index_add(1, nearest, cosine)
    torch.testing.assert_close(diagram.clamped_cosine(normals), sums, rtol=0, atol=1e-3)
    areas = torch.zeros(len(seeds)).double().index_add(0, nearest, grid.solid_angles)
    torch.testing.assert_close(diagram.solid_angles(), areas, rtol=0, atol=1e-3)


@given(st.integers(0, 10**6), st.floats(-3, 3))
@settings(max_examples=10)
def test_turning_everything_changes_nothing(seed: int, angle: float) -> None:
    seeds, normals = torch.cat([CUBE, random_directions(8, 5)]), random_directions(20, seed)
    turn = rotation_about(random_directions(1, seed + 1)[0], angle)
    there = voronoi(seeds @ turn.T).clamped_cosine(normals @ turn.T)
    torch.testing.assert_close(there, voronoi(seeds).clamped_cosine(normals), rtol=0, atol=1e-12)


def test_polygons_run_counter_clockwise() -> None:
    seeds = torch.cat([CUBE, random_directions(9, 8)])
    diagram = voronoi(seeds)
    for seed, polygon in zip(seeds, diagram.polygons, strict=True):
        corners = diagram.vertices[polygon]
        edges = torch.linalg.cross(corners, corners.roll(-1, 0))
        assert bool((edges @ seed > 0).all())


def test_chunks_do_not_show() -> None:
    diagram = voronoi(CUBE)
    normals = random_directions(2**20 // 12 + 5, 9)
    torch.testing.assert_close(
        diagram.clamped_cosine(normals)[-3:], diagram.clamped_cosine(normals[-3:])
    )
