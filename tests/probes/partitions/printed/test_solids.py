"""Walls and kernel as solids: the facts of simple designs, and what sizes are refused."""

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.printed._solids import (
    ProbeSizes,
    WallEnds,
    WallNet,
    bounded,
    core_solid,
    corners_of,
    face_radii,
    kernel_planes,
    kernel_solid,
)

SIZES = ProbeSizes(outer_mm=60.0, kernel_mm=9.0)


def net_of(name: str) -> WallNet:
    return WallNet.of(Cells.of(named_design(name)))


def test_the_kernel_of_six_cells_is_a_cube() -> None:
    solid = kernel_solid(net_of("6d"), SIZES)
    assert solid.volume() == pytest.approx(18.0**3)
    assert solid.surface_area() == pytest.approx(6 * 18.0**2)


@pytest.mark.parametrize("name", ["14d", "38d"])
def test_kernels_touch_their_ball(name: str) -> None:
    """A polyhedron round a ball of radius r has volume r / 3 times its surface."""
    solid = kernel_solid(net_of(name), SIZES)
    assert solid.volume() == pytest.approx(9.0 / 3 * solid.surface_area(), rel=1e-9)


def test_every_face_of_a_merged_design_is_flat_at_its_centre() -> None:
    """The planes of other seeds leave each face's centre free by the radius that is told."""
    sizes = ProbeSizes(outer_mm=90.0, kernel_mm=13.0)
    net = net_of("14d-outdoor")
    radii = face_radii(net, sizes)
    centres = 13.0 * net.normals
    reach = centres @ kernel_planes(net).T
    reach[np.arange(len(reach)), np.arange(len(reach))] = -np.inf
    assert (reach < 13.0 - 1e-6).all()
    assert (radii > 0).all()


def test_free_radius_of_a_cube() -> None:
    """The walls' planes are at 45 degrees to the face: r sin 45 less half a wall."""
    expected = 9.0 * np.sqrt(0.5) - 0.8
    np.testing.assert_allclose(face_radii(net_of("6d"), SIZES), expected)


def test_bounded_by_planes() -> None:
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    assert bounded(normals, np.array([1.0, 2, 3, 4, 5, 6])).volume() == pytest.approx(5 * 7 * 9)


@pytest.mark.parametrize("name", ["6d", "14d", "14d-outdoor"])
def test_the_core_lets_the_kernel_out(name: str) -> None:
    """The kernel, grown by nothing, fits into the core at every place of its way."""
    sizes = ProbeSizes(outer_mm=90.0, kernel_mm=13.0)
    net = net_of(name)
    kernel = kernel_solid(net, sizes)
    way = np.array([0.3, 0.8, 0.52])
    way /= np.linalg.norm(way)
    core = core_solid(WallEnds.of(net, corners_of(kernel)), 0.15, way)
    for distance in (0.0, 0.5, 3.0, 20.0):
        moved = kernel.translate(tuple((distance * way).tolist()))
        assert (moved - core).volume() < 1e-6


def test_walls_end_a_clearance_above_the_kernels_edges() -> None:
    """Single seeds: the plane touches the edge below, so nothing but the clearance is open."""
    net = net_of("38d")
    kernel = corners_of(kernel_solid(net, SIZES))
    _, heights = WallEnds.of(net, kernel).lowest()
    # where the kernel's surface pierces the middle of each wall
    surface = 9.0 / (net.middles @ net.normals.T).max(1)
    np.testing.assert_allclose(heights, surface, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "sizes", "message"),
    [
        (
            "110d",
            ProbeSizes(outer_mm=60.0, kernel_mm=9.0),
            "too narrow",
        ),
        ("38d", ProbeSizes(wall_mm=6.0), "walls close it"),
    ],
)
def test_cells_that_walls_close_are_refused(name: str, sizes: ProbeSizes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        face_radii(net_of(name), sizes)


def test_kernels_that_reach_outside_are_refused() -> None:
    with pytest.raises(InputError, match=r"15\.6 mm"):
        kernel_solid(net_of("6d"), ProbeSizes(outer_mm=36.0, kernel_mm=9.0))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"outer_mm": -1.0}, "outer_mm"),
        ({"kernel_mm": float("nan")}, "kernel_mm"),
        ({"wall_mm": 0.5}, "too thin to print"),
        ({"clearance_mm": 0.9}, "light passes"),
        ({"flare": 1.5}, "flare must be 0 to 1"),
        ({"outer_mm": 20.0}, "no room for walls"),
    ],
)
def test_sizes_are_checked(values: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ProbeSizes(**values)
