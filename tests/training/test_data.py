from pathlib import Path

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.skies._index import folder_hash, load_skies, read_index
from skylight.training import _skies as module
from skylight.training._skies import load_data, open_cache


@pytest.fixture
def folder(sky_folder: Path, tmp_path: Path) -> Path:
    """The same skies, without a cache."""
    for path in sky_folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).symlink_to(path)
    return tmp_path


def silent(_: str) -> None:
    pass


def test_skies_are_split_by_day_and_mapped_from_disk(folder: Path) -> None:
    messages: list[str] = []
    data = load_data(folder, messages.append)
    records = read_index(folder)
    for name in ("train", "validation"):
        skies = getattr(data, name)
        expected = load_skies(folder, [r for r in records if r.split == name])
        assert isinstance(skies, np.memmap)
        assert np.array_equal(skies, expected.numpy())
    assert data.hash == folder_hash(folder, records)
    assert [m.split(": ")[1].split()[0] for m in messages] == ["reading", "reading"]
    assert not list((folder / ".cache").glob(".partial-*"))


def test_the_cache_is_made_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_data(folder, silent)
    monkeypatch.setattr(module, "load_skies", None)
    messages: list[str] = []
    again = load_data(folder, messages.append)
    assert messages == []
    assert np.array_equal(again.train, first.train)
    assert np.array_equal(open_cache(folder, first.hash).validation, first.validation)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "no checksum"])
def test_a_damaged_cache_is_said_and_made_anew(folder: Path, damage: str) -> None:
    expected = np.array(load_data(folder, silent).train)
    (path,) = (folder / ".cache").glob("*-train.npy")
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    if damage == "no checksum":
        path.with_suffix(".sha256").unlink()
    else:
        path.write_bytes({"truncated": content[:-50], "flipped": content, "empty": b""}[damage])
    messages: list[str] = []
    assert np.array_equal(load_data(folder, messages.append).train, expected)
    assert len(messages) == 1
    assert messages[0].startswith(f"{path}: damaged")
    assert load_data(folder, messages.append)
    assert len(messages) == 1


def test_other_maps_get_another_cache(folder: Path) -> None:
    first = load_data(folder, silent)
    record = next(r for r in read_index(folder) if r.split == "train")
    other = next(r for r in read_index(folder) if r.split == "validation")
    path = folder / record.file
    path.unlink()
    path.symlink_to((folder / other.file).resolve())
    second = load_data(folder, silent)
    assert second.hash != first.hash
    assert not np.array_equal(second.train, first.train)


def test_several_processes_keep_the_order(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = np.array(load_data(folder, silent).train)
    for path in (folder / ".cache").iterdir():
        path.unlink()
    monkeypatch.setattr(module, "CHUNK", 5)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert np.array_equal(load_data(folder, silent).train, alone)


def test_progress_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHUNK", 1)
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    messages: list[str] = []
    skies = len(load_data(folder, messages.append).train)
    assert skies > 10
    assert f"{skies} of {skies} skies read" in messages


def test_a_split_without_days(sky_folder: Path, tmp_path: Path) -> None:
    rows = (sky_folder / "index.csv").read_text().splitlines()
    train_rows = [
        row
        for row, record in zip(rows[1:], read_index(sky_folder), strict=True)
        if record.split == "train"
    ]
    (tmp_path / "index.csv").write_text("\n".join([rows[0], train_rows[0]]) + "\n")
    with pytest.raises(InputError, match="too few days"):
        load_data(tmp_path)
