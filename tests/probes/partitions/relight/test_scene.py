import math

import numpy as np
import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes.partitions.relight._scene import Scene, texture_at
from tests.probes.partitions.shapes import QUAD, quad, solid


def test_a_cube_keeps_its_edges_and_a_ball_is_smooth():
    cube = solid(trimesh.creation.box())
    assert len(cube.vertices) == 24
    assert (cube.normals.abs().amax(1) > 1 - 1e-12).all()  # each along an axis
    torch.testing.assert_close(cube.normals[cube.faces].mean(1), cube.face_normals)
    ball = solid(trimesh.creation.icosphere(subdivisions=3))
    assert len(ball.vertices) == 642
    assert ((ball.normals * ball.vertices).sum(1) > 1 - 1e-3).all()


def test_seams_of_a_texture_are_no_edges_of_the_shading():
    sphere = trimesh.creation.icosphere(subdivisions=2)
    apart = torch.from_numpy(np.array(sphere.triangles)).reshape(-1, 3)  # every corner its own
    uv = torch.rand(len(apart), 2, generator=torch.Generator().manual_seed(0)).double()
    faces = torch.arange(len(apart)).reshape(-1, 3)
    texture = torch.full((4, 4, 3), 0.5)
    scene = Scene.of(apart, faces, torch.zeros(3), uv=uv, texture=texture)
    assert len(scene.vertices) == len(apart)
    assert ((scene.normals * scene.vertices).sum(1) > 0.99).all()
    assert scene.uv is not None
    # split, but nothing mixed up
    torch.testing.assert_close(scene.vertices[scene.faces], apart[faces])
    torch.testing.assert_close(scene.uv[scene.faces], uv[faces])


def test_a_texture_is_read_at_its_texels_with_v_upwards():
    texture = torch.rand(3, 5, 3, generator=torch.Generator().manual_seed(0))
    row, column = torch.meshgrid(torch.arange(3), torch.arange(5), indexing="ij")
    uv = torch.stack([(column + 0.5) / 5, 1 - (row + 0.5) / 3], 2).reshape(-1, 2).double()
    expected = texture.reshape(-1, 3).double()
    torch.testing.assert_close(texture_at(texture, uv), expected)
    torch.testing.assert_close(texture_at(texture, uv + torch.tensor([2.0, -1.0])), expected)
    between = texture_at(texture, torch.tensor([[0.4, 1 - 0.5 / 3]]).double())[0]
    torch.testing.assert_close(between, texture[0, 1:3].mean(0).double())


def test_a_vertex_of_a_chequered_floor_bounces_grey():
    texture = torch.zeros(64, 64, 3)
    texture[:32, :32] = texture[32:, 32:] = 1
    corners = torch.tensor([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]).double()
    uv = torch.tensor([[0, 0], [0, 1], [1, 1], [1, 0]]).double()
    scene = Scene.of(corners, QUAD, torch.zeros(3), uv=uv, texture=texture)
    assert float(scene.albedo.mean()) == pytest.approx(0.5, abs=0.13)
    seen = scene.albedo_at(torch.tensor([0]), torch.tensor([[0.9, 0.05, 0.05]]).double())
    assert not seen.equal(scene.albedo[:1])


def test_placing_keeps_normals_upright_and_outside_outside():
    matrix = torch.diag(torch.tensor([-3.0, 1, 2, 1])).double()  # a mirror image, stretched
    matrix[:3, 3] = torch.tensor([5.0, 0, 1])
    ball = solid(trimesh.creation.icosphere(subdivisions=3)).placed(matrix)
    middle = torch.tensor([5.0, 0, 1]).double()
    gradient = (ball.vertices - middle) / torch.tensor([9.0, 1, 4]).double()
    gradient = gradient / gradient.norm(dim=1, keepdim=True)
    assert ((ball.normals * gradient).sum(1) > 1 - 2e-3).all()
    outside = ((ball.vertices[ball.faces].mean(1) - middle) * ball.face_normals).sum(1)
    assert (outside > 0).all()
    with pytest.raises(InputError, match="undone"):
        ball.placed(torch.diag(torch.tensor([1.0, 1, 0, 1])))


def test_what_is_open_and_what_has_a_back_that_counts():
    ball = solid(trimesh.creation.icosphere(subdivisions=2))
    ground = quad([-3, -1, -3], [-3, -1, 3], [3, -1, 3], [3, -1, -3])
    screen = quad([2, -1, -1], [2, -1, 1], [2, 1, 1], [2, 1, -1])  # faces the ball
    scene = Scene.joined([ball, ground, screen])
    part = torch.tensor([0] * len(ball.faces) + [1, 1, 2, 2])
    assert scene.open_faces.equal(part > 0)
    assert scene.two_sided.equal(part == 2)  # nothing is below the ground
    turned = solid(trimesh.creation.icosphere(subdivisions=2))
    faces = turned.faces.clone()
    faces[0] = faces[0].flip(0)
    scene = Scene.of(turned.vertices, faces, torch.full((3,), 0.5))
    assert scene.open_faces.all()
    assert not quad([0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]).two_sided.any()


@pytest.mark.parametrize("inward", [False, True])
def test_backs_count_where_any_vertex_is_behind(inward: bool):
    """Against looking at every vertex from every triangle, for an open shell over a ground."""
    shell = trimesh.creation.icosphere(subdivisions=2)
    shell.update_faces(shell.triangles_center[:, 1] > -0.4)
    faces = shell.faces[:, ::-1] if inward else shell.faces
    ball = Scene.of(
        torch.from_numpy(shell.vertices.copy()),
        torch.from_numpy(faces.copy()),
        torch.full((3,), 0.5),
    )
    for scene in (
        ball,
        Scene.joined([ball, quad([-3, -1, -3], [-3, -1, 3], [3, -1, 3], [3, -1, -3])]),
    ):
        corner = scene.vertices[scene.faces[:, 0]]
        height = (scene.vertices[None] - corner[:, None]) @ scene.face_normals[:, :, None]
        behind = height[..., 0].amin(1) < -scene.raycaster.epsilon
        assert scene.two_sided.equal(behind)


def test_a_lone_triangle_has_nothing_behind_it():
    one = Scene.of(torch.eye(3), torch.tensor([[0, 1, 2]]), torch.full((3,), 0.5))
    assert not one.two_sided.any()


@pytest.mark.parametrize(
    ("vertices", "faces", "albedo", "message"),
    [
        (torch.zeros(3, 3), torch.zeros(0, 3, dtype=torch.long), 0.5, "no triangles"),
        (torch.full((3, 3), math.nan), torch.tensor([[0, 1, 2]]), 0.5, "NaN"),
        (torch.eye(3), torch.tensor([[0, 1, 3]]), 0.5, "index the 3"),
        (torch.eye(3), torch.tensor([[0, 1, 2]]), 1.5, "0 to 1"),
    ],
)
def test_what_is_refused(vertices, faces, albedo, message):
    with pytest.raises(InputError, match=message):
        Scene.of(vertices, faces, torch.full((3,), albedo))
