"""Visibility from fewer rays against all of them."""

import math

import pytest
import torch
import trimesh

from skylight.faces._model import HeadModel
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import diffuse_transport
from skylight.transport._rays import Raycaster
from skylight.transport._render import vertex_normals
from skylight.transport._visibility import PixelBlocks, adaptive_visibility

ROWS = 64


@pytest.fixture(scope="module")
def head():
    """(positions, normals, a raycaster): every 40th vertex of the mean head."""
    model = HeadModel.load()
    vertices, faces = torch.from_numpy(model.mean), torch.from_numpy(model.faces)
    normals = vertex_normals(vertices, faces)
    some = slice(0, None, 40)
    return vertices[some], normals[some], Raycaster(vertices, faces)


def test_a_head_s_transport_is_that_of_every_ray(head):
    positions, normals, caster = head
    rays = []
    occluded = caster.occluded

    def counted(origins, directions):
        rays.append(len(origins))
        return occluded(origins, directions)

    caster.occluded = counted
    whole = diffuse_transport(positions, normals, normals, caster, DirectionGrid.latlong(ROWS))
    every = sum(rays)
    rays.clear()
    found = adaptive_visibility(positions, normals, normals, caster, ROWS).transport()
    assert sum(rays) < 0.25 * every
    assert found.grid.layout == whole.grid.layout
    wrong = (found.matrix - whole.matrix).abs() > 1e-5 * whole.matrix.max()
    assert 0 < float(wrong.float().mean()) < 3e-3
    sky, above = (one.matrix[:, : ROWS * ROWS].sum(1) for one in (found, whole))
    assert float((sky - above).square().mean().sqrt()) < 2e-3 * float(above.square().mean().sqrt())


def test_what_is_wider_than_four_directions_is_exact():
    """A disc seen at 20 degrees: its rim is where cells do not agree."""
    disc = trimesh.creation.cylinder(radius=math.tan(math.radians(20)), height=1e-3, sections=64)
    disc.apply_translation([0, 0, 1.0])
    caster = Raycaster(torch.from_numpy(disc.vertices.copy()), torch.from_numpy(disc.faces.copy()))
    point, up = torch.zeros(1, 3), torch.tensor([[0.0, 0.0, 1.0]])
    whole = diffuse_transport(point, up, up, caster, DirectionGrid.latlong(ROWS))
    found = adaptive_visibility(point, up, up, caster, ROWS).transport()
    torch.testing.assert_close(found.matrix, whole.matrix, rtol=0, atol=0)
    assert float(found.matrix.sum()) == pytest.approx(math.cos(math.radians(20)) ** 2, abs=0.02)


def test_workers_and_progress_change_nothing(head):
    positions, normals, caster = head
    told = []
    one = adaptive_visibility(positions, normals, normals, caster, 16, progress=told.append)
    three = adaptive_visibility(positions, normals, normals, caster, 16, workers=3)
    assert torch.equal(one.visible, three.visible)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_rows_of_the_matrix_are_computed_when_asked_for(head):
    positions, normals, caster = head
    sight = adaptive_visibility(positions, normals, normals, caster, 16)
    whole = sight.transport()
    some = torch.tensor([3, 1, 4])
    torch.testing.assert_close(sight[some], whole.matrix[some])
    torch.testing.assert_close(sight.transport(8).matrix, whole.on_rows(8).matrix)


def test_rows_that_no_cells_divide_are_refused(head):
    positions, normals, caster = head
    with pytest.raises(ValueError, match="multiple of 4, got 18"):
        adaptive_visibility(positions, normals, normals, caster, 18)


def test_means_over_blocks_are_those_of_the_matrix(head):
    positions, normals, caster = head
    sight = adaptive_visibility(positions, normals, normals, caster, 16)
    count = len(positions)
    assert count > 64
    places = torch.stack([torch.arange(count) // 10, torch.arange(count) % 10], 1)
    weights = torch.rand(count, generator=torch.Generator().manual_seed(0))
    blocks = PixelBlocks.of(places, weights, None, 2)
    torch.testing.assert_close(blocks.means(sight), blocks.means(sight.transport().matrix))
