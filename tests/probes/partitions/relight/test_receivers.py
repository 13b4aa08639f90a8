import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes.partitions.relight._atlas import Receivers
from skylight.probes.partitions.relight._transfer import TransferSampling, transfer_coefficients
from tests.probes.partitions.shapes import corner, six_cells, solid


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_vertices_at_the_foot_of_a_wall_see_half_of_the_sky(turn):
    """Whose own place the wall's plane holds: rays must neither start behind nor in it."""
    matrix = torch.from_numpy(trimesh.transformations.rotation_matrix(turn, [0.3, 1, 0.2]))
    scene = corner((1.0, 1, 1), (1.0, 1, 1), 0.2)
    at_foot = torch.zeros(len(scene.vertices), dtype=torch.bool)
    at_foot |= (scene.vertices[:, :2].abs().amax(1) < 1e-9) & (scene.normals[:, 1] > 0.5)
    at_foot &= (scene.vertices[:, 2] - 0.5).abs() < 0.3
    assert at_foot.sum() >= 2
    sampling = TransferSampling(rays=512, bounces=0)
    found = transfer_coefficients(scene.placed(matrix), six_cells(), sampling=sampling)
    share = found.values[at_foot][:, :, 0].sum(1)
    torch.testing.assert_close(share, torch.full_like(share, 0.5), atol=0.01, rtol=0)


def test_points_on_triangles_take_what_is_interpolated_there():
    ball = solid(trimesh.creation.icosphere(subdivisions=1))
    faces = torch.arange(len(ball.faces))
    middle = torch.full((len(faces), 3), 1 / 3).double()
    points = Receivers.on_surface(ball, faces, middle)
    outward = ball.vertices[ball.faces].mean(1)
    outward = outward / outward.norm(dim=1, keepdim=True)
    torch.testing.assert_close(points.geometric_normals, outward, atol=0.05, rtol=0)
    assert ((points.normals * outward).sum(1) > 0.999).all()
    flat = ball.vertices[ball.faces].mean(1).norm(dim=1)
    assert (points.positions.norm(dim=1) > flat).all()  # lifted towards the round surface
    torch.testing.assert_close(points.albedo, ball.albedo[:1].expand(len(faces), 3))


def test_backs_look_the_other_way():
    points = Receivers.at_vertices(solid(trimesh.creation.icosphere(subdivisions=1)))
    backs = points.behind(torch.tensor([3, 5]))
    assert backs.normals.equal(-points.normals[[3, 5]])
    both = Receivers.joined(points, backs)
    assert len(both) == len(points) + 2
    assert both.albedo[-1].equal(points.albedo[5])


def test_broken_numbers_are_refused():
    rows = torch.zeros(4, 3)
    with pytest.raises(InputError, match="NaN"):
        Receivers(positions=rows / 0, normals=rows, geometric_normals=rows, albedo=rows)
