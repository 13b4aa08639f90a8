"""Exact where nothing is in the way or everything is, a fine transport matrix, two-sidedness."""

import math

import numpy as np
import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes.partitions.relight._atlas import Receivers
from skylight.probes.partitions.relight._gather import Gathered, Gatherer, Nodes, gather_all
from skylight.probes.partitions.relight._scene import Scene
from skylight.sphere._frame import DirectionGrid
from skylight.transport._cameras import Camera
from skylight.transport._matrix import diffuse_transport
from skylight.transport._render import rasterize
from tests.probes.partitions.shapes import corner, quad, six_cells, solid


def gathered(scene: Scene, receivers: Receivers | None = None, rays: int = 128, **options):
    cells, nodes = six_cells(), Nodes.of(scene)
    gatherer = Gatherer(
        receivers or nodes.receivers,
        scene,
        nodes,
        cells,
        rays=rays,
        generator=torch.Generator().manual_seed(3),
    )
    return gather_all(gatherer, **options)


def row_sums(found: Gathered) -> np.ndarray:
    return np.concatenate([np.asarray(block.sum(1)) for block in found.indirect])


def test_a_convex_body_is_lit_exactly_and_by_nothing_of_itself():
    ball = solid(trimesh.creation.icosphere(subdivisions=2))
    found = gathered(ball, rays=16)
    exact = six_cells().clamped_cosine(ball.normals) / math.pi
    np.testing.assert_allclose(found.direct, exact, atol=1e-6)
    assert not row_sums(found).any()


def test_inside_of_a_closed_body_there_is_no_light_and_all_of_the_body():
    ball = solid(trimesh.creation.icosphere(subdivisions=2))
    turned = Scene.of(ball.vertices, ball.faces.flip(1), torch.full((3,), 0.5))
    found = gathered(turned, rays=64)
    assert not found.direct.any()
    np.testing.assert_allclose(row_sums(found), 1, atol=1e-5)


def test_shares_add_up_to_one_even_with_fewer_rays_than_cells():
    scene = corner((0.5, 0.5, 0.5), (0.5, 0.5, 0.5), 0.3)
    for rays in (1, 5, 64):
        found = gathered(scene, rays=rays)
        # every back of this scene has its node
        np.testing.assert_allclose(found.direct.sum(1) + row_sums(found), 1, atol=1e-5)
        assert found.direct.min() >= 0


def test_direct_light_is_that_of_a_fine_transport_matrix():
    bunny = solid(trimesh.creation.torus(1.0, 0.35, major_sections=32, minor_sections=16))
    scene = Scene.joined([bunny, quad([-2, -2, -0.4], [2, -2, -0.4], [2, 2, -0.4], [-2, 2, -0.4])])
    cells, grid = six_cells(), DirectionGrid.latlong(96)
    points = Receivers.at_vertices(scene)
    chosen = torch.arange(0, len(points), 3)
    points = Receivers(**{k: v[chosen] for k, v in vars(points).items()})
    matrix = diffuse_transport(
        points.positions, points.normals, points.geometric_normals, scene.raycaster, grid
    )
    of_cell = torch.nn.functional.one_hot(cells.cell_of(grid.directions), cells.count)
    expected = matrix.project(of_cell.float()).numpy()
    assert expected.sum(1).min() < 0.6  # much is in shadow
    error = gathered(scene, points, rays=2048).direct - expected
    assert np.sqrt(np.square(error).mean()) < 3e-3
    assert abs(error.mean()) < 3e-4


@pytest.mark.slow
def test_the_noise_at_the_default_of_512_rays_is_as_stated():
    scene = Scene.joined(
        [
            solid(trimesh.creation.torus(1.0, 0.35, major_sections=24, minor_sections=12)),
            quad([-2, -2, -0.4], [2, -2, -0.4], [2, 2, -0.4], [-2, 2, -0.4]),
        ]
    )
    few, many = (gathered(scene, rays=rays).direct for rays in (512, 8192))
    assert np.sqrt(np.square((few - many).sum(1)).mean()) < 5e-3
    assert np.sqrt(np.square(few - many).mean()) < 3e-3


def test_both_sides_of_a_screen_shine_by_themselves():
    """Receivers left and right of a screen gather from its left and its right."""
    screen = quad([0, -50, -50], [0, -50, 50], [0, 50, 50], [0, 50, -50])  # faces -X or +X
    side = float(screen.normals[0, 0])
    # something on either side, so that both count
    posts = [quad([x, 0, 0], [x, 0, 1], [x, 1, 1], [x, 1, 0]) for x in (-40.0, 40.0)]
    scene = Scene.joined([screen, *posts])
    front = torch.tensor([[0.1 * side, 0.2, 0.3]]).double()
    toward = torch.tensor([[-side, 0, 0]]).double()
    receivers = Receivers(
        positions=torch.cat([front, -front]),
        normals=torch.cat([toward, -toward]),
        geometric_normals=torch.cat([toward, -toward]),
        albedo=torch.ones(2, 3).double(),
    )
    nodes = Nodes.of(scene)
    light = np.zeros((len(nodes), 1), np.float32)
    light[nodes.back[:4].numpy()] = 2
    light[:4] = 1
    found = gathered(scene, receivers).from_nodes(light)
    np.testing.assert_allclose(found[:, 0], [1, 2], atol=1e-2)


def test_what_a_camera_sees_starts_clear_of_the_surface():
    ball = solid(trimesh.creation.icosphere(subdivisions=2)).placed(
        torch.tensor([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -4], [0, 0, 0, 1.0]])
    )
    camera = Camera(focal_px=60.0, width=32, height=32, center_px=(16.0, 16.0))
    seen = Receivers.seen(rasterize(camera, ball.vertices, ball.faces, ball.raycaster), ball)
    found = gathered(ball, seen, rays=64)
    exact = six_cells().clamped_cosine(seen.normals) / math.pi
    np.testing.assert_allclose(found.direct, exact, atol=2e-3)
    torch.testing.assert_close(seen.albedo[0], torch.tensor([0.6, 0.5, 0.4]).double())


@pytest.mark.parametrize("rays", [0, 1 << 17])
def test_numbers_of_rays_that_are_refused(rays):
    with pytest.raises(InputError, match="rays must be"):
        gathered(quad([0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]), rays=rays)
