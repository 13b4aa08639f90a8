"""RAW files, by a DNG file that is written here (DNG 1.4, an uncompressed mosaic)."""

import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import DependencyError, InputError
from skylight.imaging._photo import read_photo

WHITE = 4095
COLOUR = np.array([1000, 2000, 500])
# XYZ (D65) to linear Rec.709 (IEC 61966-2-1): a camera that sees as the picture is shown
REC709 = (3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570)
BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL = 1, 2, 3, 4, 5, 10
_PACKED = {BYTE: "B", SHORT: "H", LONG: "I", RATIONAL: "I", SRATIONAL: "i"}
Entry = tuple[int, int, bytes | Sequence[int]]


def mosaic(height: int = 64, width: int = 96) -> np.ndarray:
    """Of one colour behind red, green, green and blue filters, saturated in a square."""
    codes = np.empty((height, width), np.uint16)
    codes[0::2, 0::2], codes[1::2, 1::2] = COLOUR[0], COLOUR[2]
    codes[0::2, 1::2] = codes[1::2, 0::2] = COLOUR[1]
    codes[20:30, 40:50] = WHITE
    return codes


def fractions(values: Sequence[float]) -> list[int]:
    return [part for value in values for part in (round(10_000 * value), 10_000)]


def directory(entries: Sequence[Entry], at: int) -> bytes:
    """A TIFF directory that begins at that byte of the file."""
    table, outside = b"", b""
    free = at + 2 + 12 * len(entries) + 4
    for tag, kind, value in entries:
        if isinstance(value, bytes):
            content, count = value, len(value)
        else:
            content = struct.pack(f"<{len(value)}{_PACKED[kind]}", *value)
            count = len(value) // (2 if kind in (RATIONAL, SRATIONAL) else 1)
        if len(content) > 4:
            place = struct.pack("<I", free + len(outside))
            outside += content + bytes(len(content) % 2)
            content = place
        table += struct.pack("<HHI", tag, kind, count) + content.ljust(4, b"\0")
    return struct.pack("<H", len(entries)) + table + bytes(4) + outside


def write_dng(
    path: Path,
    codes: np.ndarray,
    *,
    orientation: int = 1,
    rate: int | None = None,
    claimed: Sequence[Entry] = (),
) -> Path:
    """``rate``: exposed for 1 / rate seconds; ``claimed`` stand in place of true tags."""
    height, width = codes.shape
    data = codes.astype("<u2").tobytes()
    exif_at = 8 + len(data)
    exposure: list[Entry] = [] if rate is None else [(0x829A, RATIONAL, [1, rate])]
    when: Entry = (0x9003, ASCII, b"2024:06:01 14:30:00\0")
    exif = directory([*exposure, when, (0x9209, SHORT, [1])], exif_at)
    entries: list[Entry] = [
        (254, LONG, [0]),
        (256, LONG, [width]),
        (257, LONG, [height]),
        (258, SHORT, [16]),
        (259, SHORT, [1]),
        (262, SHORT, [32803]),  # a mosaic
        (271, ASCII, b"skylight\0"),
        (272, ASCII, b"test\0"),
        (273, LONG, [8]),
        (274, SHORT, [orientation]),
        (277, SHORT, [1]),
        (278, LONG, [height]),
        (279, LONG, [len(data)]),
        (33421, SHORT, [2, 2]),
        (33422, BYTE, [0, 1, 1, 2]),
        (34665, LONG, [exif_at]),
        (50706, BYTE, [1, 4, 0, 0]),
        (50708, ASCII, b"skylight test\0"),
        (50714, SHORT, [0]),
        (50717, LONG, [WHITE]),
        (50721, SRATIONAL, fractions(REC709)),
        (50728, RATIONAL, fractions((1, 1, 1))),
        (50778, SHORT, [21]),
    ]
    entries = sorted({tag[0]: tag for tag in (*entries, *claimed)}.values())
    at = exif_at + len(exif)
    header = b"II*\0" + struct.pack("<I", at)
    path.write_bytes(header + data + exif + directory(entries, at))
    return path


def test_linear_light_comes_out_as_the_sensor_saw_it(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    photo = read_photo(write_dng(tmp_path / "a.DNG", mosaic()))
    assert photo.pixels.shape == (64, 96, 3)
    expected = torch.from_numpy(COLOUR / WHITE).float()
    torch.testing.assert_close(
        photo.pixels[4:14, 4:30], expected.expand(10, 26, 3), atol=5e-4, rtol=0
    )
    assert photo.encoded.max() > 200  # brightened for detectors
    assert not photo.grey


def test_what_reached_the_white_level_is_clipped(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    photo = read_photo(write_dng(tmp_path / "a.dng", mosaic()))
    expected = torch.zeros(64, 96, dtype=torch.bool)
    expected[19:31, 39:51] = True  # and its neighbours
    assert torch.equal(photo.clipped, expected)


def test_it_is_turned_upright_with_what_is_clipped(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    plain = read_photo(write_dng(tmp_path / "a.dng", mosaic()))
    for orientation, turns in ((3, 2), (6, 3), (8, 1)):
        turned = read_photo(write_dng(tmp_path / "b.dng", mosaic(), orientation=orientation))
        torch.testing.assert_close(turned.pixels, plain.pixels.rot90(turns))
        assert torch.equal(turned.clipped, plain.clipped.rot90(turns))


def test_a_sensor_without_colour_filters_is_grey(tmp_path: Path) -> None:
    """LinearRaw of one sample a pixel, as of cameras that see no colour (DNG 1.4)."""
    pytest.importorskip("rawpy")
    grey: Entry = (262, SHORT, [34892])
    photo = read_photo(write_dng(tmp_path / "a.dng", mosaic(), claimed=[grey]))
    assert photo.pixels.shape == (64, 96, 3)
    assert photo.grey
    assert photo.pixels[0, 0, 0] == pytest.approx(COLOUR[0] / WHITE, abs=1e-3)


def test_its_exif_data_are_read(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    photo = read_photo(write_dng(tmp_path / "a.dng", mosaic()))
    assert photo.flash is True
    assert photo.taken is not None
    assert photo.taken.time is not None
    assert photo.taken.time.hour == 14


def test_damaged_exif_data_print_nothing(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    path = write_dng(tmp_path / "a.dng", mosaic())
    content = path.read_bytes()
    entry = struct.pack("<HHI", 271, ASCII, 9)
    path.write_bytes(content.replace(entry, struct.pack("<HHI", 271, ASCII, 2**30)))
    program = "import sys; from skylight.imaging._photo import read_photo; read_photo(sys.argv[1])"
    command = [sys.executable, "-c", program, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.parametrize("content", [None, b"", b"no camera's file", b"II*\0" + bytes(60)])
def test_no_raw_file_ends_in_one_line(tmp_path: Path, content: bytes | None) -> None:
    pytest.importorskip("rawpy")
    path = tmp_path / "a.nef"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="read") as error:
        read_photo(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_an_encoding_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="RAW files hold linear light"):
        read_photo(tmp_path / "a.cr2", decode=2.2)


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(DependencyError, match=r"skylight-lighting\[raw\]"):
        read_photo(write_dng(tmp_path / "a.dng", mosaic()))
