"""Voxel models: probes by their counts, files, and quarter turns."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from skylight.errors import InputError
from skylight.probes.voxel._model import VoxelModel, read_voxels, star_probe, voxelise, write_voxels


@pytest.mark.parametrize(("size", "count"), [(1, 1), (3, 7), (5, 25), (7, 63)])
def test_star_probes_are_octahedra_of_cells(size: int, count: int) -> None:
    """(2 r + 1) (2 r^2 + 2 r + 3) / 3 cells, centred octahedral numbers."""
    r = size // 2
    assert len(star_probe(size)) == count == (2 * r + 1) * (2 * r * r + 2 * r + 3) // 3


def test_quarter_turns_are_right_handed() -> None:
    """+X goes to -Z about +Y, +Y to +Z about +X, +X to +Y about +Z."""
    for axis, start, end in (("y", 0, (2, 0)), ("x", 1, (2, 1)), ("z", 0, (1, 1))):
        solid = np.zeros((3, 3, 3), bool)
        tip = [1, 1, 1]
        tip[start] = 2
        solid[tuple(tip)] = True
        turned = VoxelModel(occupied=solid).turned(axis, 1).occupied
        expected = [1, 1, 1]
        expected[end[0]] = 2 * end[1]
        assert np.argwhere(turned).tolist() == [expected]


@given(st.integers(0, 2**27 - 2), st.sampled_from("xyz"))
def test_four_quarter_turns_are_none(bits: int, axis: str) -> None:
    solid = np.array([(bits + 1) >> i & 1 for i in range(27)], bool).reshape(3, 3, 3)
    model = VoxelModel(occupied=solid)
    assert (model.turned(axis, 3).turned(axis, 1).occupied == solid).all()
    assert (model.turned(axis, -1).occupied == model.turned(axis, 3).occupied).all()


def test_npy_round_trip(tmp_path: Path) -> None:
    write_voxels(tmp_path / "a.npy", star_probe(5))
    assert (read_voxels(tmp_path / "a.npy").occupied == star_probe(5).occupied).all()


def vox(size: tuple[int, int, int], cells: list[tuple[int, int, int]]) -> bytes:
    """As MagicaVoxel writes them: PACK and RGBA beside the model."""

    def chunk(name: bytes, content: bytes, children: bytes = b"") -> bytes:
        return name + struct.pack("<ii", len(content), len(children)) + content + children

    voxels = struct.pack("<i", len(cells)) + bytes(b for c in cells for b in (*c, 7))
    model = chunk(b"SIZE", struct.pack("<iii", *size)) + chunk(b"XYZI", voxels)
    inside = chunk(b"PACK", struct.pack("<i", 1)) + model + chunk(b"RGBA", bytes(1024))
    return b"VOX " + struct.pack("<i", 150) + chunk(b"MAIN", b"", inside)


def test_vox_files_have_z_up(tmp_path: Path) -> None:
    path = tmp_path / "a.vox"
    path.write_bytes(vox((2, 3, 4), [(0, 0, 0), (1, 2, 3)]))
    found = read_voxels(path).occupied
    assert found.shape == (2, 4, 3)
    # the far (+y) side is -Z, our row 0
    assert sorted(map(tuple, np.argwhere(found).tolist())) == [(0, 0, 2), (1, 3, 0)]


def test_a_sphere_is_voxelised_solid(tmp_path: Path) -> None:
    path = tmp_path / "ball.ply"
    trimesh.creation.icosphere(subdivisions=3).export(path)
    model = voxelise(path, 20)
    volume = len(model) / 20**3 * 8  # of the cube round it, in radii
    # cells that the surface goes through count, about half of each too much
    shell = 4 * np.pi * (2 / 20) / 2
    assert 4 / 3 * np.pi < volume < 4 / 3 * np.pi + 2.2 * shell
    assert model.occupied.shape == (20, 20, 20)
    assert model.occupied[tuple(n // 2 for n in model.occupied.shape)]


@pytest.mark.parametrize("resolution", [2, 8, 24])
def test_a_box_fills_its_cells_exactly(tmp_path: Path, resolution: int) -> None:
    """2 x 1 x 1, off the origin: no cell too many, none too few."""
    path = tmp_path / "box.ply"
    box = trimesh.creation.box((2.0, 1.0, 1.0))
    box.apply_translation([0.3, -7.1, 4.4])
    box.export(path)
    model = voxelise(path, resolution)
    assert model.occupied.shape == (resolution, resolution // 2, resolution // 2)
    assert model.occupied.all()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.npy", b"x", "a .npy"),
        ("a.vox", b"PNG.", "not a MagicaVoxel"),
        ("a.vox", vox((2, 2, 2), [(0, 0, 0)])[:-1060], "MagicaVoxel|no voxels"),
        ("a.vox", vox((2, 2, 2), [(0, 0, 5)]), "damaged"),
        ("a.vox", vox((2, 2, 2), []), "is empty"),
        ("a.vox", b"VOX " + bytes(4), "damaged"),
    ],
)
def test_files_that_are_no_models_are_refused(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_voxels(tmp_path / name)


def test_grids_that_are_no_models_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "flat.npy", np.ones((2, 2), bool))
    np.save(tmp_path / "grey.npy", np.full((2, 2, 2), 0.5))
    for name in ("flat", "grey"):
        with pytest.raises(InputError, match="grid"):
            read_voxels(tmp_path / f"{name}.npy")
    with pytest.raises(InputError, match="empty"):
        VoxelModel(occupied=np.zeros((2, 2, 2), bool))
    for size in (4, 1001):
        with pytest.raises(InputError, match="odd"):
            star_probe(size)
    np.savez(tmp_path / "archive.npz", grid=np.ones((2, 2, 2), bool))
    (tmp_path / "archive.npz").rename(tmp_path / "archive.npy")
    with pytest.raises(InputError, match=r"no \.npy array"):
        read_voxels(tmp_path / "archive.npy")
    with pytest.raises(InputError, match="axis"):
        star_probe(3).turned("w", 1)
