"""The server's temporary folder, and what servers that were killed left."""

import os
import tempfile
from pathlib import Path

import pytest

from skylight.studio._state import PREFIX, own_folder

pytest.importorskip("fcntl")


def test_only_abandoned_folders_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    abandoned, starting, other, linked = (
        tmp_path / name for name in (f"{PREFIX}a", f"{PREFIX}b", "other", f"{PREFIX}link")
    )
    for folder in (abandoned, starting, other):
        folder.mkdir()
        (folder / "me.jpg").touch()
    linked.symlink_to(other)
    with own_folder() as first:
        for folder in (abandoned, other, first):
            os.utime(folder, (0, 0))
        with own_folder() as second:
            assert set(tmp_path.iterdir()) == {starting, other, linked, first, second}
            assert (other / "me.jpg").exists()
        assert not second.exists()
    assert not first.exists()
