"""Files of printed parts, and pictures of them."""

import xml.etree.ElementTree as ElementTree
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from skylight.errors import InputError
from skylight.probes.fabrication._files import shaded_picture, write_3mf, write_stl
from skylight.probes.fabrication._parts import box, part_of
from skylight.probes.voxel._parts import VoxelParts

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def test_stl_is_read_back_closed_and_of_the_same_volume(cross: VoxelParts, tmp_path: Path) -> None:
    write_stl(tmp_path / "part.stl", cross.parts[1:2])
    mesh = trimesh.load_mesh(tmp_path / "part.stl")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(cross.parts[1].volume_mm3, rel=1e-6)
    # its own normals, which trimesh takes from the file
    data = np.frombuffer(
        (tmp_path / "part.stl").read_bytes()[84:],
        np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]),
    )
    cross_product = np.cross(data["c"][:, 1] - data["c"][:, 0], data["c"][:, 2] - data["c"][:, 0])
    assert ((cross_product * data["n"]).sum(1) > 0).all()


def test_stl_has_no_negative_zero(tmp_path: Path) -> None:
    """Readers that compare bytes take it for another place than zero."""
    whole = part_of("whole", box(np.zeros(3), np.ones(3)))
    write_stl(tmp_path / "part.stl", [replace(whole, vertices=-whole.vertices)])
    layout = np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    corners = np.frombuffer((tmp_path / "part.stl").read_bytes()[84:], layout)["c"]
    assert (corners == 0).any()
    assert not np.signbit(corners[corners == 0]).any()


def test_3mf_has_units_names_and_every_triangle(cross: VoxelParts, tmp_path: Path) -> None:
    write_3mf(tmp_path / "parts.3mf", cross.parts)
    with zipfile.ZipFile(tmp_path / "parts.3mf") as archive:
        assert archive.testzip() is None
        assert set(archive.namelist()) == {
            "[Content_Types].xml",
            "_rels/.rels",
            "3D/3dmodel.model",
        }
        types = ElementTree.fromstring(archive.read("[Content_Types].xml"))
        assert {entry.get("Extension") for entry in types} == {"rels", "model"}
        relation = ElementTree.fromstring(archive.read("_rels/.rels"))[0]
        assert relation.get("Target") == "/3D/3dmodel.model"
        model = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
    assert model.get("unit") == "millimeter"
    objects = model.findall(f"{CORE}resources/{CORE}object")
    items = model.findall(f"{CORE}build/{CORE}item")
    assert [o.get("name") for o in objects] == [part.name for part in cross.parts]
    assert [i.get("objectid") for i in items] == [o.get("id") for o in objects]
    for element, part in zip(objects, cross.parts, strict=True):
        vertices = np.array(
            [[float(v.get(k)) for k in "xyz"] for v in element.iter(f"{CORE}vertex")]
        )
        faces = np.array(
            [[int(t.get(k)) for k in ("v1", "v2", "v3")] for t in element.iter(f"{CORE}triangle")]
        )
        np.testing.assert_allclose(vertices, part.vertices, atol=1e-6)
        np.testing.assert_array_equal(faces, part.faces)


def test_same_parts_same_bytes(cross: VoxelParts, tmp_path: Path) -> None:
    for write, name in ((write_stl, "a.stl"), (write_3mf, "a.3mf")):
        write(tmp_path / name, cross.parts)
        first = (tmp_path / name).read_bytes()
        write(tmp_path / name, cross.parts)
        assert (tmp_path / name).read_bytes() == first


def test_nothing_to_write(tmp_path: Path) -> None:
    for write in (write_stl, write_3mf):
        with pytest.raises(InputError, match="no part"):
            write(tmp_path / "none", [])


def test_colours_stand_where_the_parts_are() -> None:
    """A red cube to the right of a green one and a blue one above, on white."""
    cubes = [
        part_of(name, box(np.array([x, y, 0.0]), np.array([x + 1.0, y + 1.0, 1.0])))
        for name, x, y in (("red", 2.0, 0.0), ("green", 0.0, 0.0), ("blue", 0.0, 2.0))
    ]
    picture = shaded_picture(
        cubes,
        np.eye(3) * 0.8 + 0.02,
        size=(60, 60),
        up=(0, 1, 0),
        azimuth_rad=0.0,
        elevation_rad=0.0,
    ).astype(int)
    assert picture[45, 45].argmax() == 0
    assert picture[45, 15].argmax() == 1
    assert picture[15, 15].argmax() == 2
    assert (picture[15, 45] == 255).all()
