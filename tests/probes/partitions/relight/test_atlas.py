"""Where on a scene light is received: texels of an atlas, points of triangles, finer vertices."""

import numpy as np
import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes.partitions.relight._atlas import Atlas, Receivers, UnusableLayout, refined
from skylight.probes.partitions.relight._scene import Scene, texture_at
from skylight.probes.partitions.relight._transfer import TransferSampling, transfer_coefficients
from tests.probes.partitions.shapes import QUAD, corner, quad, six_cells, solid


@pytest.fixture
def painted() -> Scene:
    """A square in x and -z whose texture is as wide, v upwards along -z."""
    corners = torch.tensor([[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]]).double()
    texture = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0))
    uv = corners[:, [0, 2]] * torch.tensor([1.0, -1.0])
    return Scene.of(corners, QUAD, torch.zeros(3), uv=uv, texture=texture)


def test_texels_lie_where_the_texture_says_and_have_its_colours(painted):
    atlas = Atlas.of_file(painted, 8)
    assert atlas.covered.all()
    points = atlas.receivers(painted)
    row, column = torch.meshgrid(torch.arange(8), torch.arange(8), indexing="ij")
    x, v = (column.flatten() + 0.5) / 8, 1 - (row.flatten() + 0.5) / 8
    expected = torch.stack([x, torch.zeros_like(x), -v], 1).double()
    torch.testing.assert_close(points.positions, expected, atol=1e-6, rtol=0)
    assert painted.texture is not None
    torch.testing.assert_close(
        atlas.image(points.albedo).float(), painted.texture, atol=1e-5, rtol=0
    )


def test_a_texture_of_places_looked_up_gives_the_places():
    """Across charts and their borders, by the layout that xatlas finds."""
    pytest.importorskip("xatlas")
    scene = solid(trimesh.creation.box((1.0, 0.6, 0.8)))
    atlas = Atlas.of_charts(scene, 128)
    points = atlas.receivers(scene)
    assert 0.3 < float(atlas.covered.float().mean()) < 1
    places = atlas.image(points.positions).float()
    generator = torch.Generator().manual_seed(0)
    face = torch.randint(len(scene.faces), (5000,), generator=generator)
    weights = torch.rand(5000, 3, generator=generator).double() ** 2
    weights = weights / weights.sum(1, keepdim=True)
    uv = (atlas.corners[face] * weights[:, :, None]).sum(1)
    found = texture_at(places, uv)
    expected = scene.interpolated(scene.vertices, face, weights)
    # a texel is 0.02 long
    assert float((found - expected).norm(dim=1).max()) < 0.035
    normals = atlas.image(points.geometric_normals)
    assert normals.shape == (128, 128, 3)


def test_texels_receive_what_their_points_do():
    pytest.importorskip("xatlas")
    ball = solid(trimesh.creation.icosphere(subdivisions=2), albedo=(0.9, 0.5, 0.2))
    atlas = Atlas.of_charts(ball, 64)
    found = transfer_coefficients(
        ball, six_cells(), atlas.receivers(ball), sampling=TransferSampling(rays=32, bounces=1)
    )
    picture = atlas.image(found.values)
    assert picture.shape == (64, 64, 6, 3)
    np.testing.assert_allclose(picture.sum(2).mean((0, 1)), [0.9, 0.5, 0.2], atol=2e-3)


def layout(*triangles: list[list[float]]) -> Scene:
    """Triangles side by side, (0, 0), (1, 0), (0, 1) in space, with these places in a texture."""
    count = len(triangles)
    one = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 1, 0]]).double()
    corners = (one + torch.arange(count).double()[:, None, None] * torch.eye(3)[2]).reshape(-1, 3)
    uv = torch.tensor(triangles).reshape(-1, 2).double()
    faces = torch.arange(3 * count).reshape(-1, 3)
    return Scene.of(corners, faces, torch.zeros(3), uv=uv, texture=torch.zeros(1, 1, 3))


LOWER, UPPER = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]]


def test_triangles_that_overlap_are_refused():
    # the diagonal, which is both's, goes through texels' centres
    assert Atlas.of_file(layout(LOWER, UPPER), 16).covered.all()
    shifted = [[1.0, 0.8], [0.0, 0.8], [0.8, 0.0]]
    over = Atlas(corners=torch.tensor([LOWER, shifted]), size=64)
    along = (torch.arange(64).double() + 0.5) / 64
    v, u = torch.meshgrid(along.flip(0), along, indexing="ij")
    right = u - v / 4 < 0.8  # the side from (0.8, 0) to (1, 0.8)
    expected = (u + v < 1) & (v < 0.8) & (u + v > 0.8) & right
    assert float((over.overlapping != expected).float().mean()) < 0.002
    assert 0.1 < float(expected.float().mean()) < 0.2
    with pytest.raises(UnusableLayout, match=r"overlap: \d+ texels of 64 x 64.*charts"):
        Atlas.of_file(layout(LOWER, shifted), 64)
    # the same place twice, and once as a mirror image
    for again in (LOWER, LOWER[::-1]):
        with pytest.raises(UnusableLayout, match="overlap"):
            Atlas.of_file(layout(LOWER, again), 16)


def test_swatches_of_colour_are_no_places():
    point = [[0.9, 0.9]] * 3
    with pytest.raises(UnusableLayout, match="50 %"):
        Atlas.of_file(layout(LOWER, point), 16)


def test_charts_do_not_overlap():
    pytest.importorskip("xatlas")
    ball = solid(trimesh.creation.icosphere(subdivisions=3))
    atlas = Atlas.of_charts(ball, 256)
    assert not atlas.overlapping.any()
    vertex, uv, faces = atlas.vertices(ball)
    torch.testing.assert_close(vertex[faces], ball.faces)
    torch.testing.assert_close(uv[faces], atlas.corners)
    assert len(vertex) < len(ball.vertices) * 1.5


def test_what_is_refused(painted):
    with pytest.raises(InputError, match="repeats"):
        Atlas(corners=painted.uv[painted.faces] * 2, size=8)
    with pytest.raises(InputError, match="4 texels"):
        Atlas(corners=torch.zeros(1, 3, 2), size=0)
    with pytest.raises(InputError, match="no texture coordinates"):
        Atlas.of_file(solid(trimesh.creation.box()), 8)
    speck = Atlas(corners=torch.full((1, 3, 2), 0.3), size=4)
    with pytest.raises(InputError, match="no texel"):
        speck.image(torch.zeros(0, 3))


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
