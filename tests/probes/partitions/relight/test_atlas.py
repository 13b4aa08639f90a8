import numpy as np
import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes.partitions.relight._atlas import Atlas, UnusableLayout
from skylight.probes.partitions.relight._scene import Scene, texture_at
from skylight.probes.partitions.relight._transfer import TransferSampling, transfer_coefficients
from tests.probes.partitions.shapes import QUAD, six_cells, solid


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
