import gzip
import json
import os
import struct
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from skylight.io._bounded import (
    PIXELS_MAX,
    file_bytes,
    json_content,
    load_array,
    load_arrays,
    require_pixels,
)


def npy(shape: object, content: bytes = b"", descr: str = "<f8") -> bytes:
    """A .npy stream whose header says what it likes."""
    head = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + content


_HEAD = b"{'descr': [('a', '<U2')], 'fortran_order': False, 'shape': (1,)}\n"
_RECORDS = struct.pack("<H", len(_HEAD)) + _HEAD


def npz(path: Path, members: dict[str, bytes], *, packed: bool = True) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED if packed else 0) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def test_what_is_written_is_read(tmp_path: Path) -> None:
    table = np.arange(12.0).reshape(3, 4)
    np.save(tmp_path / "a.npy", table)
    np.savez_compressed(tmp_path / "a.npz", x=table, name=np.array("me"), rows=table.T)
    assert (load_array(tmp_path / "a.npy") == table).all()
    found = load_arrays(tmp_path / "a.npz", ("x", "name", "rows"))
    assert str(found["name"]) == "me"
    assert (found["x"] == table).all()
    assert (found["rows"] == table.T).all()


@pytest.mark.parametrize(
    "content",
    [
        npy((10**12,)),  # more than it has
        npy((10**30, 0)),
        npy((1,), b"\0" * 16),  # less
        npy((-1,), b""),
        npy((2, -1), b"\0" * 16),
        npy((1,), b"\0" * 8, "|O"),
        b"\x93NUMPY\x01\x00" + _RECORDS + b"\xff" * 8,
        npy("(" * 3000),
        b"\x93NUMPY\x02\x00\xff\xff\xff\x7f",
        b"\x93NUMPY\x09\x00\x00",
        b"",
    ],
)
def test_headers_that_lie_are_refused_before_memory_is_taken(
    tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ValueError, match=r"header|objects|records"):
        load_array(tmp_path / "a.npy")
    npz(tmp_path / "a.npz", {"x.npy": content})
    with pytest.raises(ValueError, match=r"header|objects|records"):
        load_arrays(tmp_path / "a.npz", ("x",))


@pytest.mark.parametrize("order", "<>")
def test_text_of_no_characters_is_refused(tmp_path: Path, order: str) -> None:
    """numpy makes texts of it that Python cannot even print."""
    path, archive = tmp_path / "a.npy", tmp_path / "a.npz"
    for text, is_refused in (("aé光\U0010ffff", False), ("\x00", False), ("", False), ("aa", True)):
        array = np.array([text], dtype=f"{order}U4")
        np.save(path, array)
        if is_refused:
            content = path.read_bytes()
            path.write_bytes(content[:-4] + b"\xff" * 4)
        with zipfile.ZipFile(archive, "w") as packed:
            packed.write(path, "a.npy")
        for read in (lambda: load_array(path), lambda: load_arrays(archive, ["a"])["a"]):
            if is_refused:
                with pytest.raises(ValueError, match="no character"):
                    read()
            else:
                assert read()[0] == array[0]


def test_an_archive_that_grows_is_refused(tmp_path: Path) -> None:
    bomb = npz(tmp_path / "bomb.npz", {"x.npy": npy((4, 2**20), b"\0" * 2**25)})
    assert bomb.stat().st_size < 2**16
    with pytest.raises(ValueError, match="exceed"):
        load_arrays(bomb, ("x",), most=2**24)
    plain = npz(tmp_path / "plain.npz", {"x.npy": npy((4, 2**20), b"\0" * 2**25)}, packed=False)
    assert load_arrays(plain, ("x",), most=2**24)["x"].shape == (4, 2**20)


@pytest.mark.parametrize("packing", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_ways_of_packing_are_refused(tmp_path: Path, packing: int) -> None:
    """Damaged LZMA raises an error of its own, and its header may ask for 4 GB."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w", packing) as archive:
        archive.writestr("x.npy", npy((1,), b"\0" * 8))
    with pytest.raises(ValueError, match="deflate it"):
        load_arrays(tmp_path / "a.npz", ("x",))


def test_damaged_archives(tmp_path: Path) -> None:
    content = BytesIO()
    np.savez(content, x=np.arange(100.0))
    whole = content.getvalue()
    path = tmp_path / "a.npz"
    for cut in range(0, len(whole), len(whole) // 16):
        path.write_bytes(whole[:cut])
        with pytest.raises(ValueError, match=r"."):
            load_arrays(path, ("x",))
    flipped = bytearray(whole)
    flipped[400] ^= 1  # within the numbers
    path.write_bytes(flipped)
    with pytest.raises(ValueError, match="CRC"):
        load_arrays(path, ("x",))
    path.write_bytes(whole)
    with pytest.raises(ValueError, match="other"):
        load_arrays(path, ("other",))


def test_json(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"a": [1, 2.5, "x", 2**62]}))
    assert json_content(path) == {"a": [1, 2.5, "x", 2**62]}
    path.write_text("1" + "0" * 30)
    assert json_content(path) == 1e30
    for number, read in ((2**63 - 1, int), (2**63, float), (-(2**63), int), (-(2**63) - 1, float)):
        path.write_text(str(number))
        assert type(json_content(path)) is read
        assert json_content(path) == read(number)
    for number in ("1" + "0" * 400, "-1e999", "NaN", "-Infinity"):
        path.write_text(f'{{"a": [{number}]}}')
        with pytest.raises(ValueError, match="no number"):
            json_content(path)
    path.write_text("[" * 100_000)
    with pytest.raises(ValueError, match="deeply"):
        json_content(path)
    path.write_text(r'{"a": "\ud83d\ude00"}')  # a pair of surrogates is one character
    assert json_content(path) == {"a": "\U0001f600"}
    for text in (r'["\ud800"]', r'{"a\uDFFF": 1}'):  # Python's reader takes them alone too
        path.write_text(text)
        with pytest.raises(ValueError, match="no character"):
            json_content(path)
    path.write_text(" " * 101)
    with pytest.raises(ValueError, match="100"):
        json_content(path, most=100)
    path.write_bytes(gzip.compress(b"{}"))
    with pytest.raises(ValueError, match="utf-8"):
        json_content(path)


def test_only_ordinary_files_are_opened(tmp_path: Path) -> None:
    """A pipe would be waited for, and some devices never end."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(OSError, match="device or a pipe"):
            file_bytes(path)
    with pytest.raises(IsADirectoryError):
        file_bytes(tmp_path)
    with pytest.raises(FileNotFoundError):
        file_bytes(tmp_path / "none")


def test_sizes_of_pictures() -> None:
    require_pixels(16_384, PIXELS_MAX // 16_384)
    for size in ((16_384, PIXELS_MAX // 16_384 + 1), (0, 5), (-3, -3)):
        with pytest.raises(ValueError, match=f"{size[0]}x{size[1]}"):
            require_pixels(*size)
