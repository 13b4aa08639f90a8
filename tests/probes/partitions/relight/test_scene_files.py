import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from skylight.errors import InputError
from skylight.probes.partitions.relight._scene import read_scene

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
        else trimesh.visual.material.SimpleMaterial(image=Image.fromarray(codes))
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


def test_files_that_cannot_be_used(tmp_path):
    with pytest.raises(InputError, match="no such mesh"):
        read_scene(tmp_path / "none.ply")
    (tmp_path / "mesh.txt").write_text("v")
    with pytest.raises(InputError, match="no mesh known"):
        read_scene(tmp_path / "mesh.txt")
    (tmp_path / "mesh.ply").write_text("ply nonsense")
    with pytest.raises(InputError, match=r"mesh\.ply: damaged"):
        read_scene(tmp_path / "mesh.ply")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    with pytest.raises(InputError, match="no faces"):
        read_scene(tmp_path / "points.ply")
