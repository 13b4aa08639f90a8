"""Which files of a folder count."""

from pathlib import Path

from skylight.io._atomic import atomic_path
from skylight.io._files import visible_files


def test_files_of_a_kind_sorted(tmp_path: Path) -> None:
    (tmp_path / "deep.exr").mkdir()
    for name in ("b.EXR", "a.hdr", "c.png", "deep.exr/d.exr"):
        (tmp_path / name).touch()

    def names(**options: bool) -> list[str]:
        found = visible_files(tmp_path, (".exr", ".hdr"), **options)
        return [path.relative_to(tmp_path).as_posix() for path in found]

    assert names() == ["a.hdr", "b.EXR"]
    assert names(recursive=True) == ["a.hdr", "b.EXR", "deep.exr/d.exr"]


def test_what_is_half_written_does_not_count(tmp_path: Path) -> None:
    (tmp_path / ".partial-123").mkdir()
    (tmp_path / ".partial-123" / "probe.exr").touch()
    with atomic_path(tmp_path / "whole.exr") as temporary:
        assert temporary.exists()
        assert visible_files(tmp_path, {".exr"}, recursive=True) == []
    assert visible_files(tmp_path, {".exr"}, recursive=True) == [tmp_path / "whole.exr"]


def test_a_hidden_folder_itself_can_be_listed(tmp_path: Path) -> None:
    folder = tmp_path / ".cache"
    folder.mkdir()
    (folder / "sky.exr").touch()
    assert visible_files(folder, {".exr"}) == [folder / "sky.exr"]
