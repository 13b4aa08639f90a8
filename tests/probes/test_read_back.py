"""The STL files of printed probes, read back by trimesh and manifold3d as slicers do."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Error, Manifold, Mesh

from skylight.cli import main
from skylight.errors import InputError
from skylight.probes.fabrication import _files
from skylight.probes.fabrication._mount import MarkerBoard, Pole, marker_base
from skylight.probes.fabrication._parts import PrintedPart, PrintSizes, box, lay_out, part_of
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions.printed._assembly import AskedSizes, fitted_sizes
from skylight.probes.partitions.printed._halves import probe_parts, standing_rotation
from skylight.probes.partitions.printed._printing import lying_parts
from skylight.probes.voxel._model import VoxelModel, star_probe
from skylight.probes.voxel._parts import voxel_parts
from skylight.probes.voxel._printing import print_voxel_probe

QUICK = ("6d", "14d")
BASE = marker_base(Pole(), MarkerBoard(), wall_mm=1.6, clearance_mm=0.15)


def require_closed(path: Path, pieces: int = 1) -> None:
    """Every edge between two triangles, as trimesh and manifold3d take the file."""
    mesh = trimesh.load_mesh(path)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == pieces
    assert len(mesh.faces) == int.from_bytes(path.read_bytes()[80:84], "little")
    solid = Manifold(
        Mesh(
            vert_properties=np.asarray(mesh.vertices, np.float32),
            tri_verts=np.asarray(mesh.faces, np.uint32),
        )
    )
    assert solid.status() == Error.NoError
    assert len(solid.decompose()) == pieces
    assert 0 < solid.volume() == pytest.approx(mesh.volume, rel=1e-5)


def require_all_closed(folder: Path) -> None:
    files = sorted(folder.glob("*.stl"))
    for path in files:
        require_closed(path, len(files) - 2 if path.stem == "parts" else 1)


def shells(name: str, *, pole_mm: float = 6.0, **asked: float) -> list[PrintedPart]:
    cells = Cells.of(named_design(name))
    sizes = fitted_sizes(cells, AskedSizes(**asked), pole_mm=pole_mm)
    return lying_parts(
        probe_parts(cells, sizes, rotation=standing_rotation(cells), pole_mm=pole_mm)
    )


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in design_names()]
)
def test_partition_probes(name: str, tmp_path: Path) -> None:
    """14d, 38d and others had edges of four triangles."""
    files = _files.write_printed_parts(tmp_path, lay_out(shells(name)), BASE)
    assert [file.name for file in files] == [
        "kernel.stl",
        "marker_base.stl",
        "parts.stl",
        "shell_lower.stl",
        "shell_upper.stl",
    ]
    require_all_closed(tmp_path)


SIZES = [
    {"outer_mm": 40.0},
    {"outer_mm": 60.0, "flare": 0.0},
    {"outer_mm": 80.0, "flare": 0.0},
    {"outer_mm": 100.0},
    {"outer_mm": 120.0, "flare": 0.5},
    {"wall_mm": 0.8},
    {"wall_mm": 2.1, "clearance_mm": 0.25},
    {"pole_mm": 3.0},
    {"pole_mm": 10.0},
]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6d", "14d", "38d", "14d-indoor", "14d-outdoor"])
@pytest.mark.parametrize("asked", SIZES, ids=str)
def test_partition_probes_of_other_sizes(
    name: str, asked: dict[str, float], tmp_path: Path
) -> None:
    try:
        parts = shells(name, **asked)
    except InputError:
        pytest.skip("a size that is refused")
    _files.write_printed_parts(tmp_path, lay_out(parts), BASE)
    require_all_closed(tmp_path)


@pytest.mark.parametrize(
    ("size", "face_mm"),
    [
        (3, 20.0),
        *(pytest.param(n, f, marks=pytest.mark.slow) for n in (1, 5) for f in (13.3, 40.0)),
    ],
)
def test_voxel_probes(size: int, face_mm: float, tmp_path: Path) -> None:
    result = print_voxel_probe(star_probe(size), PrintSizes(face_mm=face_mm), title="")
    _files.write_printed_parts(tmp_path, result.bed, result.base)
    require_all_closed(tmp_path)


def test_a_crooked_chain_of_the_smallest_faces(tmp_path: Path) -> None:
    """Collars beside each other leave vertices that float32 cannot tell apart."""
    occupied = np.zeros((3, 3, 3), bool)
    occupied[(1, 1, 1, 2), (1, 1, 2, 1), (1, 2, 1, 2)] = True
    sizes = PrintSizes(face_mm=10.2)
    assert sizes.face_mm == pytest.approx(6 * sizes.wall_mm + 4 * sizes.clearance_mm)
    parts = voxel_parts(VoxelModel(occupied=occupied), sizes).parts
    _files.write_printed_parts(tmp_path, lay_out(parts), BASE)
    require_all_closed(tmp_path)


@pytest.mark.parametrize("diameter_mm", [2.0, 4.0, 6.35, 10.0])
def test_mounts(diameter_mm: float, tmp_path: Path) -> None:
    pole = Pole(diameter_mm=diameter_mm, length_mm=150.0)
    base = marker_base(pole, MarkerBoard(width_mm=203.2), wall_mm=1.2, clearance_mm=0.1)
    result = print_voxel_probe(star_probe(1), PrintSizes(), title="", pole=pole)
    for file in _files.write_printed_parts(tmp_path, result.bed, base):
        assert file.watertight
    require_all_closed(tmp_path)


def test_files_that_are_not_closed_are_refused(tmp_path: Path) -> None:
    """A part without a triangle, and two that touch along an edge on the bed."""
    whole = part_of("whole", box(np.zeros(3), np.ones(3)))
    holed = replace(whole, name="holed", faces=whole.faces[1:])
    with pytest.raises(InputError, match=r"holed\.stl would not be closed"):
        _files.write_printed_parts(tmp_path, lay_out([holed]), BASE)
    (tmp_path / "holed.stl").unlink()
    bed = lay_out([whole])
    touching = replace(bed, parts=(*bed.parts, bed.parts[0].shifted(np.array([1.0, 1.0, 0.0]))))
    with pytest.raises(InputError, match=r"parts\.stl would not be closed"):
        _files.write_printed_parts(tmp_path, touching, BASE)


def broken(write: Callable[..., None]) -> Callable[..., None]:
    def without_a_triangle(path: Path, parts: list[PrintedPart]) -> None:
        write(path, [replace(parts[0], faces=parts[0].faces[1:]), *parts[1:]])

    return without_a_triangle


def test_the_command_keeps_what_is_there_where_a_new_file_is_not_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(_files, "shaded_picture", None)
    monkeypatch.setattr(_files, "write_stl", broken(_files.write_stl))
    (tmp_path / "parts.stl").write_bytes(b"good")
    assert main(["probe", "voxel", "print", "--probe", "1", "--out", str(tmp_path)]) == 2
    assert "foot.stl would not be closed" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["parts.stl"]
    assert (tmp_path / "parts.stl").read_bytes() == b"good"
