"""Any folder is a user's: each evaluation takes what is there, and says what it needs."""

from pathlib import Path

import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.evaluation._main import EVALUATIONS, evaluate
from skylight.evaluation._run import mesh_files, probes_folder
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap

USUAL = ("bunny.ply", "dragon.ply")


def with_files(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def test_probes_are_in_hdr_or_in_the_folder_itself(tmp_path: Path) -> None:
    with_files(tmp_path, "a/hdr/index.csv", "b/index.csv", "c/hdr/map.exr")
    assert probes_folder(tmp_path / "a") == tmp_path / "a/hdr"
    assert probes_folder(tmp_path / "b") == tmp_path / "b"
    with pytest.raises(InputError):
        probes_folder(tmp_path / "c")


def test_other_meshes_stand_in_for_missing_ones(tmp_path: Path) -> None:
    def found(*names: str) -> list[str]:
        folder = tmp_path / "-".join(names).replace("/", "_")
        with_files(folder, "hdr/index.csv", *names)
        from_all, from_maps = (mesh_files(f, USUAL) for f in (folder, folder / "hdr"))
        assert from_all == from_maps
        return [path.name for path in from_all]

    assert found("meshes/a.ply", "meshes/bunny.ply", "meshes/dragon.ply") == list(USUAL)
    assert found("meshes/a.ply", "meshes/b.obj", "meshes/dragon.ply") == ["dragon.ply", "a.ply"]
    assert found("meshes/a.ply", "meshes/notes.txt") == ["a.ply"]
    with pytest.raises(InputError):
        found("meshes/notes.txt")


@pytest.mark.parametrize("name", EVALUATIONS)
def test_an_empty_folder_is_refused_in_a_line(name: str, tmp_path: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    for _ in range(2):  # no folder, then an empty one
        with pytest.raises(InputError) as refused:
            evaluate(name, quick=True, data=data, out=out, workers=1)
        assert str(data) in str(refused.value)
        assert "\n" not in str(refused.value)
        data.mkdir(exist_ok=True)


@pytest.mark.parametrize("name", ["voxel-probe", "partition-probe", "sparse-inverse"])
def test_probes_without_a_mesh_are_refused_before_anything_is_measured(
    name: str, tmp_path: Path
) -> None:
    with_files(tmp_path, "hdr/room.exr")
    (tmp_path / "hdr/index.csv").write_text("file,category\nroom.exr,indoor\n")
    with pytest.raises(InputError, match="no mesh"):
        evaluate(name, quick=True, data=tmp_path, out=tmp_path / "out")


@pytest.mark.slow
def test_a_folder_of_ones_own_is_measured(tmp_path: Path) -> None:
    """One map in a folder of its own, one mesh of no usual name, and no sunny day."""
    light = EnvironmentMap(radiance=torch.tensor([1.0, 0.8, 0.6]).expand(16, 32, 3).clone())
    (tmp_path / "hdr/rooms").mkdir(parents=True)
    (tmp_path / "meshes").mkdir()
    write_environment_map(tmp_path / "hdr/rooms/mine.exr", light)
    (tmp_path / "hdr/index.csv").write_text("file,category\nrooms/mine.exr,indoor\n")
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "meshes" / "ball.ply")
    out = tmp_path / "out"
    evaluate("partition-probe", quick=True, data=tmp_path, out=out, workers=1)
    assert (out / "pictures" / "rooms_mine.exr.png").is_file()
