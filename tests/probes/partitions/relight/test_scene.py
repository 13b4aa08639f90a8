"""Scenes: their edges, textures and backs, and what is read from mesh files."""

import math

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from skylight.errors import InputError
from skylight.probes.partitions.relight._scene import Scene, read_scene, texture_at
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


CODES = np.array([[255, 0, 0, 255], [0, 128, 0, 255], [64, 64, 64, 255], [255, 255, 255, 255]])
SRGB = torch.tensor([[1, 0, 0], [0, 0.21586, 0], [0.05127, 0.05127, 0.05127], [1, 1, 1]])
SQUARE = [[0.0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]


def square(**options) -> trimesh.Trimesh:
    return trimesh.Trimesh(SQUARE, [[0, 1, 2], [0, 2, 3]], process=False, **options)


def by_place(scene) -> dict:
    places = scene.vertices.round(decimals=6).tolist()
    return dict(zip(map(tuple, places), scene.albedo, strict=True))


@pytest.mark.parametrize(("suffix", "linear"), [("ply", False), ("obj", False), ("glb", True)])
def test_colours_of_vertices(tmp_path, suffix, linear):
    square(vertex_colors=CODES.astype(np.uint8)).export(tmp_path / f"square.{suffix}")
    found = by_place(read_scene(tmp_path / f"square.{suffix}"))
    expected = torch.from_numpy(CODES[:, :3] / 255) if linear else SRGB.double()
    for place, colour in zip(SQUARE, expected, strict=True):
        torch.testing.assert_close(found[tuple(place)], colour, atol=1e-4, rtol=0)


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_a_texture_lies_where_it_was_and_is_made_linear(tmp_path, suffix):
    codes = np.full((8, 8, 3), 128, np.uint8)
    codes[:4, :4] = [255, 0, 0]  # the upper left quarter: u < 1/2, v > 1/2
    uv = np.array([[0.0, 0], [0, 1], [1, 1], [1, 0]])
    material = (
        PBRMaterial(baseColorTexture=Image.fromarray(codes))
        if suffix == "glb"
        else SimpleMaterial(image=Image.fromarray(codes))
    )
    square(visual=TextureVisuals(uv=uv, material=material)).export(tmp_path / f"t.{suffix}")
    scene = read_scene(tmp_path / f"t.{suffix}")
    assert scene.texture is not None
    corner_of = {tuple(p): i for i, p in enumerate(scene.vertices.round(decimals=6).tolist())}
    corner = corner_of[0.0, 0.0, 1.0]  # u = 0, v = 1
    face = int((scene.faces == corner).any(1).nonzero()[0])
    near = torch.where(scene.faces[face] == corner, 0.8, 0.1)[None].double()
    seen = scene.albedo_at(torch.tensor([face]), near)[0]
    torch.testing.assert_close(seen, torch.tensor([1.0, 0, 0]).double(), atol=0.02, rtol=0)
    corner = corner_of[1.0, 0.0, 0.0]
    face = int((scene.faces == corner).any(1).nonzero()[0])
    near = torch.where(scene.faces[face] == corner, 0.8, 0.1)[None].double()
    seen = scene.albedo_at(torch.tensor([face]), near)[0]
    torch.testing.assert_close(seen, torch.full((3,), 0.21586).double(), atol=0.02, rtol=0)


def test_several_meshes_with_materials_in_their_places(tmp_path):
    red = PBRMaterial(baseColorFactor=[1.0, 0.0, 0.0, 1.0])
    grey = PBRMaterial(baseColorFactor=[0.4, 0.4, 0.4, 1.0])
    both = trimesh.Scene()
    both.add_geometry(square(visual=TextureVisuals(material=red)))
    lifted = np.eye(4)
    lifted[1, 3] = 2
    both.add_geometry(square(visual=TextureVisuals(material=grey)), transform=lifted)
    both.export(tmp_path / "both.glb")
    scene = read_scene(tmp_path / "both.glb")
    low = scene.vertices[:, 1] < 1
    assert low.sum() == 4
    torch.testing.assert_close(scene.albedo[low], torch.tensor([[1.0, 0, 0]] * 4).double())
    torch.testing.assert_close(scene.albedo[~low], torch.full((4, 3), 0.4).double())


def test_a_cube_without_colours_has_the_albedo_that_is_given(tmp_path):
    trimesh.creation.box().export(tmp_path / "cube.stl")
    scene = read_scene(tmp_path / "cube.stl", albedo=(0.2, 0.3, 0.4))
    assert len(scene.vertices) == 24  # welded, and split at its edges
    assert not scene.open_faces.any()
    torch.testing.assert_close(scene.albedo[5], torch.tensor([0.2, 0.3, 0.4]).double())


@pytest.mark.parametrize(
    ("corners", "uv"),
    [
        ("vt 0 0 0\nvt 1 0 0\nvt 0 1 0", [[0, 0], [1, 0], [0, 1]]),
        ("vt 0\nvt 1\nvt 0", None),
        ("vt 0 0\nvt 1e300 0\nvt 0 1", None),
        ("vt 0 0\nvt nan 0\nvt 0 1", None),
    ],
)
def test_places_in_a_texture_are_pairs_of_numbers(tmp_path, corners, uv):
    """Three to a vertex are for solid textures; one crashed, and NaN went into the albedo."""
    Image.new("RGB", (4, 4), (200, 100, 50)).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    mesh = tmp_path / "a.obj"
    mesh.write_text(
        f"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n{corners}\nusemtl a\nf 1/1 2/2 3/3\n"
    )
    if uv is None:
        with pytest.raises(InputError, match="no pairs"):
            read_scene(mesh)
    else:
        found = read_scene(mesh)
        torch.testing.assert_close(found.uv, torch.tensor(uv, dtype=torch.float64))


@pytest.mark.parametrize("depth", [8, 16])
def test_grey_textures_of_both_depths(tmp_path, depth):
    codes = np.full((4, 4), 100, np.uint8)
    deep = codes if depth == 8 else codes.astype(np.uint16) * 257
    Image.fromarray(deep).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{corners}usemtl a\nf 1/1 2/2 3/3\n")
    texture = read_scene(tmp_path / "a.obj").texture
    light = ((100 / 255 + 0.055) / 1.055) ** 2.4
    torch.testing.assert_close(texture, torch.full((4, 4, 3), light))


def test_files_that_cannot_be_used(tmp_path):
    with pytest.raises(InputError, match="no such mesh"):
        read_scene(tmp_path / "none.ply")
    (tmp_path / "mesh.txt").write_text("v")
    with pytest.raises(InputError, match="no mesh known"):
        read_scene(tmp_path / "mesh.txt")
    (tmp_path / "mesh.ply").write_text("ply nonsense")
    with pytest.raises(InputError, match=r"mesh\.ply: not read as"):
        read_scene(tmp_path / "mesh.ply")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    with pytest.raises(InputError, match="no faces"):
        read_scene(tmp_path / "points.ply")
