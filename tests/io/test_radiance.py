"""Radiance pictures as other programs write them."""

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from skylight.errors import InputError
from skylight.io._colour_spaces import to_xyz
from skylight.io._hdr import rgbe_codes
from skylight.io._light import read_linear
from skylight.io._radiance import radiance_size, rgbe_values

HEIGHT, WIDTH = 8, 16


def some_codes(seed: int = 0) -> np.ndarray:
    light = np.random.default_rng(seed).uniform(0, 2, (HEIGHT, WIDTH, 3)) ** 8
    return rgbe_codes(light.astype(np.float32))


def write(
    path: Path,
    codes: np.ndarray,
    *lines: str,
    axes: str | None = None,
    data: bytes | None = None,
) -> Path:
    axes = axes or f"-Y {len(codes)} +X {codes.shape[1]}"
    head = "\n".join(["#?RADIANCE", *lines, "", axes, ""])
    path.write_bytes(head.encode() + (codes.tobytes() if data is None else data))
    return path


def new_runs(codes: np.ndarray) -> bytes:
    """Each channel of each row as one run of literals, as the format allows."""
    rows = []
    for row in codes:
        rows.append(bytes([2, 2, len(row) >> 8, len(row) & 255]))
        rows += [bytes([len(row)]) + row[:, channel].tobytes() for channel in range(4)]
    return b"".join(rows)


def test_values_are_opencvs(tmp_path: Path) -> None:
    codes = some_codes()
    codes[0, 0] = 0
    codes[0, 1] = [255, 3, 0, 1]  # the smallest exponent
    codes[0, 2] = [128, 255, 1, 255]
    path = write(tmp_path / "a.hdr", codes, "FORMAT=32-bit_rle_rgbe")
    bgr = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(rgbe_values(codes), bgr[..., ::-1])
    np.testing.assert_array_equal(read_linear(path), bgr[..., ::-1])


@pytest.mark.parametrize("suffix", [".hdr", ".pic", ".HDR"])
@pytest.mark.parametrize("line", ["FORMAT=32-bit_rle_rgbe", "SOFTWARE=any"])
def test_new_runs_and_headers_without_a_format(tmp_path: Path, suffix: str, line: str) -> None:
    codes = some_codes()
    path = write(tmp_path / f"a{suffix}", codes, line, data=new_runs(codes))
    np.testing.assert_array_equal(read_linear(path), rgbe_values(codes))


@pytest.mark.parametrize("rows", ["-Y", "+Y"])
@pytest.mark.parametrize("columns", ["+X", "-X"])
@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("runs", [False, True])
def test_all_orientations(
    tmp_path: Path, rows: str, columns: str, across: bool, runs: bool
) -> None:
    """Scan lines as the header names them: the first axis is that of the lines."""
    codes = some_codes()
    stored = codes[:: -1 if rows == "+Y" else 1, :: -1 if columns == "-X" else 1]
    axes = f"{rows} {HEIGHT} {columns} {WIDTH}"
    if across:
        stored = stored.transpose(1, 0, 2)
        axes = f"{columns} {WIDTH} {rows} {HEIGHT}"
    stored = np.ascontiguousarray(stored)
    data = new_runs(stored) if runs else stored.tobytes()
    path = write(tmp_path / "a.hdr", stored, axes=axes, data=data)
    np.testing.assert_array_equal(read_linear(path), rgbe_values(codes))
    assert radiance_size(path.read_bytes()) == (HEIGHT, WIDTH)


def test_old_runs(tmp_path: Path) -> None:
    """(1, 1, 1, n) repeats n times; a second mark in a row counts 256 n."""
    a, b = [200, 10, 0, 130], [3, 128, 9, 120]
    width = 1 + 3 + 2 * 256 + 1
    row = np.array([a, [1, 1, 1, 3], [1, 1, 1, 2], b], np.uint8)
    codes = np.concatenate([np.tile(a, (width - 1, 1)), [b]]).astype(np.uint8)
    path = write(tmp_path / "a.hdr", row[None], axes=f"-Y 2 +X {width}", data=row.tobytes() * 2)
    np.testing.assert_array_equal(read_linear(path), rgbe_values(np.stack([codes, codes])))
    for data, what in (
        (row.tobytes(), "fewer than its"),
        (row[1:].tobytes() * 2, "repeat nothing"),
        (row.tobytes() + row[:3].tobytes(), "fewer than its"),
    ):
        path = write(tmp_path / "b.hdr", row[None], axes=f"-Y 2 +X {width}", data=data)
        with pytest.raises(InputError, match=f"damaged.*{what}"):
            read_linear(path)


def test_marks_in_a_file_that_is_not_packed_are_pixels(tmp_path: Path) -> None:
    codes = some_codes()
    codes[3, 3] = [1, 1, 1, 9]
    path = write(tmp_path / "a.hdr", codes)
    np.testing.assert_array_equal(read_linear(path), rgbe_values(codes))


def test_exposures_and_corrections_multiply_and_are_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    codes = some_codes()
    plain = rgbe_values(codes)
    lines = ["EXPOSURE=2", "EXPOSURE= 0.25", "COLORCORR=2 1 0.5", "\tEXPOSURE=9"]
    with caplog.at_level(logging.WARNING):
        got = read_linear(write(tmp_path / "a.hdr", codes, *lines))
    np.testing.assert_allclose(got, plain / 0.5 / [2, 1, 0.5], rtol=1e-6)
    exposure, colours = (record.getMessage() for record in caplog.records)
    assert "divided by EXPOSURE 0.5, which other readers ignore" in exposure
    assert "COLORCORR 2 1 0.5" in colours
    caplog.clear()
    ones = ["EXPOSURE=1.0", "COLORCORR=1 1 1", "GAMMA=1", "PIXASPECT=1"]
    np.testing.assert_array_equal(read_linear(write(tmp_path / "b.hdr", codes, *ones)), plain)
    assert not caplog.records


def test_xyze_and_primaries_keep_the_xyz(tmp_path: Path) -> None:
    light = np.random.default_rng(1).uniform(0.5, 1, (HEIGHT, WIDTH, 3))
    xyz = light @ to_xyz("rec709").T
    path = write(tmp_path / "a.hdr", rgbe_codes(xyz.astype(np.float32)), "FORMAT=32-bit_rle_xyze")
    # codes round by 1/512 of the largest; the matrix has rows of absolute sum 5.3 at most
    np.testing.assert_allclose(read_linear(path), light, atol=5.3 * 1.1 / 256)
    stored = xyz @ np.linalg.inv(to_xyz("rec2020")).T
    line = "PRIMARIES=0.708 0.292 0.170 0.797 0.131 0.046 0.3127 0.3290"
    path = write(tmp_path / "b.hdr", rgbe_codes(stored.astype(np.float32)), line)
    np.testing.assert_allclose(read_linear(path), light, atol=2.4 / 256)


def test_the_default_primaries_say_no_more_than_none(tmp_path: Path) -> None:
    codes = some_codes()
    line = "PRIMARIES=0.640 0.330 0.290 0.600 0.150 0.060 0.333 0.333"
    got = read_linear(write(tmp_path / "a.hdr", codes, line))
    np.testing.assert_array_equal(got, rgbe_values(codes))


@pytest.mark.parametrize("gamma", ["2.2", "0.454545"])
def test_gamma_is_undone_whichever_way_it_is_told(tmp_path: Path, gamma: str) -> None:
    codes = some_codes()
    got = read_linear(write(tmp_path / "a.hdr", codes, f"GAMMA={gamma}"))
    np.testing.assert_allclose(got, rgbe_values(codes).astype(np.float64) ** 2.2, rtol=1e-4)


def test_pixel_aspect_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        read_linear(write(tmp_path / "a.hdr", some_codes(), "PIXASPECT=2"))
    assert "PIXASPECT" in caplog.text


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("FORMAT=32-bit_rle_hsv", "32-bit_rle_hsv"),
        ("EXPOSURE=0", "EXPOSURE=0"),
        ("COLORCORR=1 2", "COLORCORR=1 2, expected 3"),
        ("PRIMARIES=a", "PRIMARIES=a"),
        ("GAMMA=-1", "GAMMA=-1"),
    ],
)
def test_what_is_valid_but_not_known_is_not_damaged(tmp_path: Path, line: str, what: str) -> None:
    with pytest.raises(InputError, match=what) as error:
        read_linear(write(tmp_path / "a.hdr", some_codes(), line))
    assert "damaged" not in str(error.value)


def test_damage_is_named_where_it_shows(tmp_path: Path) -> None:
    codes = some_codes()
    whole = new_runs(codes)
    for data, what in ((whole[:-40], "run lengths"), (codes.tobytes()[:-4], "fewer than")):
        with pytest.raises(InputError, match=f"damaged or cut short.*{what}"):
            read_linear(write(tmp_path / "a.hdr", codes, data=data))
    (tmp_path / "b.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n")
    with pytest.raises(InputError, match="damaged or cut short"):
        read_linear(tmp_path / "b.hdr")
    (tmp_path / "c.pic").write_bytes(b"\x53\x80\xf6\x34")
    with pytest.raises(InputError, match="no Radiance file"):
        read_linear(tmp_path / "c.pic")
