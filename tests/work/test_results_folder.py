"""A folder of results that appear together or not at all."""

import errno
from pathlib import Path

import pytest

from skylight.errors import OutputError
from skylight.estimation._report import SOME_FILES
from skylight.probes.voxel._printing_files import PART_FILES
from skylight.work._resumable import locked, results_folder
from tests.cli.test_cli import contents


def fill(folder: Path, *names: str, stop: BaseException | None = None) -> None:
    with results_folder(folder, SOME_FILES) as partial:
        for name in names:
            (partial / name).write_text("new")
        if stop:
            raise stop


@pytest.mark.parametrize("stop", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_what_stops_a_run_leaves_no_trace(stop: BaseException, tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    (old / "a.txt").write_text("good")
    for folder in (old, new):
        with pytest.raises(type(stop)):
            fill(folder, "a.txt", stop=stop)
    assert contents(old) == {"a.txt": b"good"}
    assert not new.exists()


def test_meshes_of_an_earlier_run_go_and_nothing_else(tmp_path: Path) -> None:
    mine = ("mesh_of_me.obj", "mesh_1.ply")
    for name in mine:
        (tmp_path / name).write_text("mine")
    fill(tmp_path, "mesh_1.obj", "mesh_2.obj", "mesh_10.obj")
    with pytest.raises(KeyboardInterrupt):
        fill(tmp_path, "mesh.obj", stop=KeyboardInterrupt())
    assert {*contents(tmp_path)} == {*mine, "mesh_1.obj", "mesh_2.obj", "mesh_10.obj"}
    fill(tmp_path, "mesh.obj")
    assert {*contents(tmp_path)} == {*mine, "mesh.obj"}
    fill(tmp_path, "mesh_1.obj", "mesh_2.obj")
    assert {*contents(tmp_path)} == {*mine, "mesh_1.obj", "mesh_2.obj"}


def test_a_film_after_a_photograph_and_the_other_way(tmp_path: Path) -> None:
    """Else the lamps of one would be exported as those of the other."""
    photo, film = (
        {"estimate.json", "mesh_1.obj", "mesh_2.obj"},
        {"film.json", "probe_000.exr", "mesh.obj"},
    )
    kept = {"settings.json", "film_of_me.json"}  # a film goes on by its settings
    for name in kept:
        (tmp_path / name).write_text("mine")
    for names in (photo, film, photo):
        fill(tmp_path, *names)
        assert {*contents(tmp_path)} == names | kept


def test_parts_of_a_larger_probe_go(tmp_path: Path) -> None:
    for count in (120, 7):
        names = {f"part_{n + 1:0{len(str(count))}d}.stl" for n in range(count)} | {"parts.stl"}
        names = {name if count > 9 else name.replace("part_", "part_0") for name in names}
        with results_folder(tmp_path, PART_FILES) as partial:
            for name in names:
                (partial / name).write_text("new")
        assert {*contents(tmp_path)} == names


def test_a_file_in_the_folders_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(OutputError, match="it is a file; give a folder"):
        fill(tmp_path / "out", "a.txt")
    with pytest.raises(OutputError, match="it is a file; give a folder"), locked(tmp_path / "out"):
        pass
    assert (tmp_path / "out").read_text() == "mine"


def test_a_folder_in_a_files_place_is_kept(tmp_path: Path) -> None:
    (tmp_path / "b.txt").mkdir()
    with pytest.raises(OutputError, match="folder"):
        fill(tmp_path, "a.txt", "b.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["b.txt"]
