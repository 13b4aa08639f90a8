"""Meshes stay closed as files hold them: broken ones are found, touching and close ones mended."""

import igl
import numpy as np
import pytest
from manifold3d import CrossSection, Manifold, Mesh64

from skylight.probes.fabrication import _parts
from skylight.probes.fabrication._parts import box
from skylight.probes.fabrication._watertight import (
    RESOLUTION_MM,
    broken_edges,
    by_place,
    watertight_mesh,
)
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.printed._assembly import AskedSizes, fitted_sizes
from skylight.probes.partitions.printed._halves import probe_parts, standing_rotation

CUBE = box(np.zeros(3), np.ones(3))


def raw(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts).astype(np.int64)


def corners(solid: Manifold) -> np.ndarray:
    vertices, faces = raw(solid)
    return vertices[faces]


def hausdorff_mm(first: Manifold, vertices: np.ndarray, faces: np.ndarray) -> float:
    """From vertices and middles of edges and triangles of either surface to the other one."""
    ours, theirs = (vertices, faces), raw(first)

    def farthest(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> float:
        c = a[0][a[1]]
        points = np.concatenate(
            [c.reshape(-1, 3), (c[:, 1:] + c[:, :2]).reshape(-1, 3) / 2, c.mean(1)]
        )
        return float(np.sqrt(igl.point_mesh_squared_distance(points, *b)[0].max()))

    return max(farthest(ours, theirs), farthest(theirs, ours))


def test_a_closed_surface_has_no_broken_edge_and_one_without_a_triangle_three() -> None:
    assert broken_edges(corners(CUBE)).shape == (0, 2, 3)
    assert len(broken_edges(corners(CUBE)[1:])) == 3


def test_an_edge_of_four_triangles_is_broken() -> None:
    """Two cubes that share an edge: each closed, and as topology has it, both."""
    both = CUBE + CUBE.translate((1.0, 1.0, 0.0))
    assert both.status().name == "NoError"
    (edge,) = broken_edges(corners(both))
    np.testing.assert_array_equal(edge[edge[:, 2].argsort()], [[1, 1, 0], [1, 1, 1]])


def test_vertices_that_float32_cannot_tell_apart_break_edges() -> None:
    """A step of 1e-6 at 100 mm, where float32 numbers are 7.6e-6 apart."""
    away = corners(CUBE.scale((1e-6, 1.0, 1.0)).translate((100.0, 0.0, 0.0)))
    vertices, faces = by_place(away)
    assert len(vertices) == 4
    assert len(faces) == 12
    # the four sides; either diagonal has two or four triangles
    assert len(broken_edges(away)) in (4, 5)


def test_solids_that_touch_along_an_edge_are_parted_there() -> None:
    both = CUBE + CUBE.translate((1.0, 1.0, 0.0))
    vertices, faces = watertight_mesh(both)
    assert not len(broken_edges(vertices[faces]))
    parted = Manifold(Mesh64(vert_properties=vertices, tri_verts=faces))
    assert len(parted.decompose()) == 2
    # what is cut away is within a groove of half its diagonal 0.02 mm
    assert 0 < both.volume() - parted.volume() < (2 * 0.02**2) * 1.1
    assert hausdorff_mm(both, vertices, faces) <= 0.02 + RESOLUTION_MM


def test_close_vertices_become_one() -> None:
    """A prism with a corner cut off by 1e-4 mm, far from the origin; before, it breaks."""
    outline = np.array([[0, 0], [1 - 5e-6, 0], [1, 5e-6], [1, 1], [0, 1]])
    prism = Manifold.extrude(CrossSection([outline]), 1.0).translate((200.0, 200.0, 0.0))
    assert prism.num_vert() == 10
    assert len(broken_edges(corners(prism)))
    vertices, faces = watertight_mesh(prism)
    assert not len(broken_edges(vertices[faces]))
    assert len(vertices) == 8
    assert hausdorff_mm(prism, vertices, faces) <= 1e-5


@pytest.mark.parametrize("away_mm", [0.0, 300.0, 900.0])
def test_overlapping_rods_at_odd_angles(away_mm: float) -> None:
    """Booleans of many that share an axis and ends; the surface moves by less than a micrometre."""
    rod = Manifold.cylinder(20.0, 1.0, 1.2, 48)
    solid = Manifold()
    for turn in np.linspace(0.0, 180.0, 9):
        solid += rod.rotate((0.0, turn, turn / 3))
    vertices, faces = watertight_mesh(solid.translate((away_mm, 0.0, 0.0)))
    assert not len(broken_edges(vertices[faces]))
    far = vertices - [away_mm, 0.0, 0.0]
    assert hausdorff_mm(solid, far, faces) < 1e-3
    area = solid.surface_area()
    back = Manifold(Mesh64(vert_properties=far, tri_verts=faces))
    assert abs(back.volume() - solid.volume()) < 1e-3 * area


@pytest.mark.parametrize("name", ["6d", pytest.param("38d", marks=pytest.mark.slow)])
def test_shells_move_by_less_than_a_micrometre(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of the finest step of printers; and so much volume at most, over the surface."""
    made: list[Manifold] = []

    def kept(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
        made.append(solid)
        return watertight_mesh(solid)

    monkeypatch.setattr(_parts, "watertight_mesh", kept)
    cells = Cells.of(named_design(name))
    sizes = fitted_sizes(cells, AskedSizes(), pole_mm=6.0)
    printed = probe_parts(cells, sizes, rotation=standing_rotation(cells), pole_mm=6.0)
    for part, solid in zip((printed.lower, printed.upper, printed.kernel), made, strict=True):
        assert hausdorff_mm(solid, part.vertices, part.faces) < 1e-3
        assert abs(part.volume_mm3 - solid.volume()) < 1e-3 * solid.surface_area()


def test_what_is_well_apart_stays_as_it_is() -> None:
    solid = box(np.array([0.1, 0.2, 0.3]), np.array([20.0, 30, 40])) - box(
        np.array([1.0, 1, 1]), np.array([5.0, 5, 50])
    )
    vertices, _ = watertight_mesh(solid)
    assert {tuple(v) for v in vertices} == {tuple(v) for v in raw(solid)[0]}
