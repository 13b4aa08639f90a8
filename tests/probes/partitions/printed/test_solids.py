"""Walls, rims and kernel as solids: the facts of simple designs, and what sizes are refused."""

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.printed._solids import (
    SEEN_DISC,
    ProbeSizes,
    WallEnds,
    WallNet,
    bounded,
    core_solid,
    corners_of,
    face_radii,
    kernel_planes,
    kernel_solid,
    rim_halves,
    wall_solid,
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


FLARED = ProbeSizes(outer_mm=60.0, kernel_mm=9.0, flare=1.0)
ENDS = np.array([[1.0, 0, 0], [0, 1.0, 0]])
POLE = np.array([0.0, 0, 1.0])


def test_a_thin_wall_is_a_sector() -> None:
    wall = wall_solid(ENDS, POLE, np.array([0.8, 0.8]), SIZES)
    assert wall.volume() == pytest.approx(np.pi * 30**2 / 4 * 1.6, rel=1e-3)
    low, high = np.array(wall.bounding_box()).reshape(2, 3)
    np.testing.assert_allclose(low, [0, 0, -0.8], atol=1e-9)
    np.testing.assert_allclose(high, [30, 30, 0.8], atol=1e-9)


def test_a_flared_wall_has_the_section_that_is_told() -> None:
    """Thin to 1.25 kernel radii, then even growth, and parallel for the last 2.5 walls."""
    wall = wall_solid(ENDS, POLE, np.array([3.0, 2.0]), FLARED)
    across = np.array([1.0, -1.0, 0.0]) / 2**0.5
    way = np.array([1.0, 1.0, 0.0]) / 2**0.5
    for radius, above, below in ((10.0, 0.8, 0.8), (27.0, 3.0, 2.0), (29.5, 3.0, 2.0)):
        thin = wall.trim_by_plane(tuple(way), radius - 0.01)
        thin = thin.trim_by_plane(tuple(-way), -radius - 0.01)
        thin = thin.trim_by_plane(tuple(across), -0.01).trim_by_plane(tuple(-across), -0.01)
        low, high = np.array(thin.bounding_box()).reshape(2, 3)
        np.testing.assert_allclose([high[2], -low[2]], [above, below], atol=2e-3)
    halfway = (1.25 * 9 + 26) / 2
    thin = wall.trim_by_plane(tuple(way), halfway).trim_by_plane(tuple(across), -0.01)
    thin = thin.trim_by_plane(tuple(-across), -0.01).trim_by_plane(tuple(-way), -halfway - 0.01)
    assert np.array(thin.bounding_box())[5] == pytest.approx(1.9, abs=2e-3)


@pytest.mark.parametrize("angle", [0.02, 0.1, 0.5, 2.5])
def test_walls_of_any_length_are_closed(angle: float) -> None:
    ends = np.array([[1.0, 0, 0], [np.cos(angle), np.sin(angle), 0]])
    wall = wall_solid(ends, POLE, np.array([0.8, 0.8]), SIZES)
    assert wall.volume() == pytest.approx(angle * 30**2 / 2 * 1.6, rel=2e-3)
    wide = wall_solid(ends, POLE, np.array([3.0, 2.0]), FLARED)
    assert wide.genus() == 0
    assert wide.volume() > wall.volume()


def test_the_rims_of_a_cube() -> None:
    """A face's centre is r sin 45 from its walls' planes, and so is its disc by that less."""
    half = 9 * np.sqrt(0.5)
    disc = SEEN_DISC * (half - 0.8)
    widest = 0.9 * (half - disc * np.sqrt(0.5))
    np.testing.assert_allclose(rim_halves(net_of("6d"), FLARED), widest)
    np.testing.assert_allclose(rim_halves(net_of("6d"), SIZES), 0.8)
    some = ProbeSizes(outer_mm=60.0, kernel_mm=9.0, flare=0.5)
    np.testing.assert_allclose(rim_halves(net_of("6d"), some), (widest + 0.8) / 2)


@pytest.mark.parametrize("name", ["14d", "14d-indoor", "14d-outdoor"])
def test_rims_reach_nine_tenths_of_the_way_to_the_line_of_sight_of_each_disc(name: str) -> None:
    """Of the point of the disc that is nearest to the wall's plane."""
    sizes = ProbeSizes(outer_mm=130.0, kernel_mm=13.0, flare=1.0)
    net = net_of(name)
    rims, discs = rim_halves(net, sizes), SEEN_DISC * face_radii(net, sizes)
    turn = np.linspace(0, 2 * np.pi, 721)
    for side, sign, cells in ((0, 1.0, net.left), (1, -1.0, net.right)):
        for wall, cell in enumerate(cells):
            normal = net.normals[cell]
            across = np.linalg.svd(normal[None])[2][1:]
            circle = np.stack([np.cos(turn), np.sin(turn)], 1) @ across
            points = 13.0 * normal + discs[cell] * circle
            nearest = float((points @ (sign * net.poles[wall])).min())
            assert rims[wall, side] == pytest.approx(max(0.9 * nearest, 0.8), abs=1e-3)
