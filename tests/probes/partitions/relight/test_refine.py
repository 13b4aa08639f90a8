import numpy as np
import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes.partitions.relight._atlas import refined
from tests.probes.partitions.shapes import quad, solid


@pytest.mark.parametrize("longest", [0.9, 0.33, 0.12])
def test_edges_are_short_and_the_surface_is_the_same_and_closed(longest):
    box = solid(trimesh.creation.box((1.0, 0.4, 0.7)))
    fine = refined(box, longest)
    mesh = trimesh.Trimesh(fine.vertices.numpy(), fine.faces.numpy())
    assert mesh.edges_unique_length.max() <= longest
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert not fine.open_faces.any()
    assert mesh.volume == pytest.approx(0.28)
    assert mesh.area == pytest.approx(2 * (0.4 + 0.7 + 0.28))
    corners = fine.normals[fine.faces]
    torch.testing.assert_close(corners, fine.face_normals[:, None].expand_as(corners))


def test_a_surface_that_is_fine_enough_stays_as_it_is():
    box = solid(trimesh.creation.box())
    assert refined(box, 1.5) is box


def test_colours_are_interpolated():
    floor = quad([0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0])
    ramp = floor.vertices[:, :1].expand(-1, 3)
    fine = refined(type(floor).of(floor.vertices, floor.faces, ramp), 0.1)
    np.testing.assert_allclose(fine.albedo[:, 0], fine.vertices[:, 0], atol=1e-12)


def test_endless_work_is_refused():
    with pytest.raises(InputError, match="more than"):
        refined(quad([0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]), 1e-4)
    with pytest.raises(InputError, match="above 0"):
        refined(solid(trimesh.creation.box()), 0.0)
