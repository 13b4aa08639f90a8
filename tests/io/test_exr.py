"""OpenEXR files as other programs write them: layers, windows, declared colours, subsampling."""

import logging
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from skylight.errors import InputError
from skylight.io._colour_spaces import CHROMATICITIES, to_xyz
from skylight.io._exr import read_exr
from skylight.io._light import read_linear

SIZE = (8, 16)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767)


def some_light(seed: int = 0, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 2, (*size, 3)).astype(np.float32)


def write(path: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    plain = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**plain, **header}, channels).write(str(path))
    return path


def named(light: np.ndarray, names: list[str]) -> dict[str, np.ndarray]:
    return {name: light[..., k].copy() for k, name in enumerate(names)}


# ---- layers


@pytest.mark.parametrize(
    "names",
    [
        ["r", "g", "b"],
        ["Red", "Green", "Blue"],
        ["rgb.R", "rgb.G", "rgb.B"],
        ["ViewLayer.Combined.R", "ViewLayer.Combined.G", "ViewLayer.Combined.B"],
    ],
)
def test_other_names_of_the_channels(tmp_path: Path, names: list[str]) -> None:
    light = some_light()
    others = {"ViewLayer.Depth.Z": light[..., 0] * 9, "N.X": light[..., 1], "N.Y": light[..., 2]}
    path = write(tmp_path / "a.exr", {**named(light, names), **others})
    pixels, notes = read_exr(path, None)
    np.testing.assert_array_equal(pixels, light)
    assert notes == []


def test_layers_are_chosen_by_name_or_where_it_is_clear(tmp_path: Path) -> None:
    one, two = some_light(1), some_light(2)
    both = {
        **named(one, [f"View.Combined.{c}" for c in "RGB"]),
        **named(two, [f"View.DiffCol.{c}" for c in "RGB"]),
    }
    path = write(tmp_path / "a.exr", both)
    pixels, notes = read_exr(path, None)
    np.testing.assert_array_equal(pixels, one)
    assert "DiffCol" in notes[0]
    for name in ("View.DiffCol", "diffcol"):
        np.testing.assert_array_equal(read_exr(path, name)[0], two)
    with pytest.raises(InputError, match=r"'none'.*View\.Combined, View\.DiffCol"):
        read_exr(path, "none")
    unclear = {key.replace("Combined", "Direct"): value for key, value in both.items()}
    path = write(tmp_path / "b.exr", unclear)
    with pytest.raises(InputError, match=r"several layers, View\.DiffCol, View\.Direct") as error:
        read_exr(path, None)
    assert "--layer" in str(error.value)
    plain = write(tmp_path / "c.exr", {**unclear, **named(two, list("RGB"))})
    pixels, notes = read_exr(plain, None)
    np.testing.assert_array_equal(pixels, two)
    assert notes == []


def test_the_first_part_with_colours_or_the_named_one(tmp_path: Path) -> None:
    one, two = some_light(1), some_light(2)
    parts = [
        OpenEXR.Part({"name": "depth"}, {"Z": one[..., 0].copy()}),
        OpenEXR.Part({"name": "left"}, named(one, list("RGB"))),
        OpenEXR.Part({"name": "right"}, named(two, list("RGB"))),
    ]
    path = tmp_path / "a.exr"
    OpenEXR.File(parts).write(str(path))
    pixels, notes = read_exr(path, None)
    np.testing.assert_array_equal(pixels, one)
    assert "left" in notes[0]
    np.testing.assert_array_equal(read_exr(path, "right")[0], two)


def test_a_part_that_says_it_is_data_is_no_colour(tmp_path: Path) -> None:
    one, two = some_light(1), some_light(2)
    parts = [
        OpenEXR.Part({"name": "n", "colorInteropID": "data"}, named(one, list("RGB"))),
        OpenEXR.Part({"name": "c"}, named(two, list("RGB"))),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr", None)[0], two)


# ---- windows


def window(low: tuple[int, int], high: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    return np.array(low, np.int32), np.array(high, np.int32)


def test_what_lies_outside_the_display_window_is_cropped(tmp_path: Path) -> None:
    light = some_light()
    alpha = np.ones(SIZE, np.float32)
    alpha[0] = 0  # outside
    path = write(
        tmp_path / "a.exr",
        {**named(light, list("RGB")), "A": alpha},
        dataWindow=window((-2, -1), (13, 6)),
        displayWindow=window((0, 0), (9, 4)),
    )
    pixels, notes = read_exr(path, None)
    np.testing.assert_array_equal(pixels, light[1:6, 2:12])
    assert notes == []


def test_a_part_of_the_picture_is_refused_with_both_sizes(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.exr",
        named(some_light(), list("RGB")),
        displayWindow=window((0, 0), (31, 7)),
    )
    with pytest.raises(InputError, match=r"16x8 pixels.*32x8.*uncropped") as error:
        read_linear(path)
    assert "damaged" not in str(error.value)


# ---- colours


@pytest.mark.parametrize("name", ["ap0", "ap1", "rec2020", "p3-d65", "adobe-rgb"])
@pytest.mark.parametrize("by", ["chromaticities", "colorInteropID", "oiio:ColorSpace"])
def test_declared_primaries_are_converted(tmp_path: Path, name, by: str) -> None:
    light = some_light().astype(np.float64)
    stored = light @ to_xyz("rec709").T @ np.linalg.inv(to_xyz(name)).T  # the same XYZ
    words = {"p3-d65": "p3d65", "adobe-rgb": "adobergb"}.get(name, name)
    value = CHROMATICITIES[name] if by == "chromaticities" else f"lin_{words}_scene"
    path = write(tmp_path / "a.exr", {"RGB": stored.astype(np.float32)}, **{by: value})
    pixels, (note,) = read_exr(path, None)
    np.testing.assert_allclose(pixels, light, rtol=1e-5, atol=1e-6)
    assert "converted to linear Rec.709" in note
    assert ("white" in note) == name.startswith("ap")


def test_declared_curves_are_undone(tmp_path: Path) -> None:
    light = some_light() / 2
    srgb = np.where(light > 0.0031308, 1.055 * light ** (1 / 2.4) - 0.055, 12.92 * light)
    for value, stored in (("srgb_rec709_scene", srgb), ("g18_rec709_scene", light ** (1 / 1.8))):
        path = write(tmp_path / "a.exr", {"RGB": stored.astype(np.float32)}, colorInteropID=value)
        np.testing.assert_allclose(read_exr(path, None)[0], light, rtol=1e-5)


def test_what_is_linear_rec709_stays_bit_for_bit(tmp_path: Path) -> None:
    light = some_light()
    for header in (
        {},
        {"chromaticities": CHROMATICITIES["rec709"]},
        {"colorInteropID": "lin_rec709_scene", "chromaticities": CHROMATICITIES["rec709"]},
        {"colorInteropID": "unknown"},
        {"oiio:ColorSpace": "Linear"},
    ):
        pixels, notes = read_exr(write(tmp_path / "a.exr", {"RGB": light}, **header), None)
        np.testing.assert_array_equal(pixels, light)
        assert notes == []


def test_an_aces_container_has_aces_primaries(tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", {"RGB": some_light()}, acesImageContainerFlag=1)
    told = write(tmp_path / "b.exr", {"RGB": some_light()}, chromaticities=ACES)
    np.testing.assert_array_equal(read_exr(path, None)[0], read_exr(told, None)[0])


def test_colours_that_are_not_known_or_contradict_each_other(tmp_path: Path) -> None:
    light = some_light()
    path = write(tmp_path / "a.exr", {"RGB": light}, colorInteropID="lin_awg3_scene")
    with pytest.raises(InputError, match="'lin_awg3_scene' is not known"):
        read_linear(path)
    path = write(
        tmp_path / "b.exr", {"RGB": light}, colorInteropID="lin_rec709_scene", chromaticities=ACES
    )
    with pytest.raises(InputError, match="chromaticities say others"):
        read_linear(path)
    path = write(tmp_path / "c.exr", {"RGB": light}, chromaticities=(0.1,) * 8)
    with pytest.raises(InputError, match="no triangle"):
        read_linear(path)


# ---- what is said and what is refused


def test_holes_and_pixel_shapes_are_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    light = some_light()
    alpha = np.ones(SIZE, np.float32)
    light[6:], alpha[6:] = 0, 0
    alpha[0, :3] = 0.5
    path = write(
        tmp_path / "a.exr",
        {"RGBA": np.concatenate([light, alpha[..., None]], -1)},
        pixelAspectRatio=2.0,
    )
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(read_linear(path), light)
    holes, aspect = (record.getMessage() for record in caplog.records)
    assert "32 pixel(s) are transparent and black and 3 pixel(s) are half" in holes
    assert str(path) in holes
    assert "2 times as wide" in aspect
    empty = write(
        tmp_path / "b.exr",
        {"RGBA": np.concatenate([some_light(), np.zeros((*SIZE, 1), np.float32)], -1)},
    )
    assert read_exr(empty, None)[1] == []  # colours everywhere: alpha was left empty


def test_true_reasons(tmp_path: Path) -> None:
    (tmp_path / "text.exr").write_text("no light")
    whole = {"RGB": np.ones((*SIZE, 3), np.uint32)}
    for path, what in (
        (tmp_path / "text.exr", "no OpenEXR file"),
        (write(tmp_path / "uint.exr", whole), "IDs, not light"),
        (write(tmp_path / "depth.exr", {"Z": np.ones(SIZE, np.float32)}), "channels R, G, B or Y"),
    ):
        with pytest.raises(InputError, match=what) as error:
            read_linear(path)
        assert "damaged" not in str(error.value)
    (tmp_path / "light.hdr").write_bytes(b"")
    with pytest.raises(InputError, match=r"only \.exr files have layers"):
        read_linear(tmp_path / "light.hdr", layer="a")


# ---- luminance and chroma


def write_subsampled(path: Path, channels: dict[str, tuple[np.ndarray, int, int]]) -> Path:
    """A half, uncompressed file as the format describes it: the library writes no such channels."""

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value

    height = max(len(values) * down for values, _, down in channels.values())
    width = max(values.shape[1] * across for values, across, _ in channels.values())
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iB3xii", 1, 0, across, down)
        for name, (_, across, down) in sorted(channels.items())
    )
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = b"\x76\x2f\x31\x01" + struct.pack("<i", 2)
    head += attribute("channels", "chlist", listed + b"\0")
    head += attribute("compression", "compression", b"\0") + attribute("dataWindow", "box2i", box)
    head += attribute("displayWindow", "box2i", box) + attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    head += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0))
    head += attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    lines = []
    for y in range(height):
        line = b"".join(
            values[y // down].astype("<f2").tobytes()
            for _, (values, _, down) in sorted(channels.items())
            if y % down == 0
        )
        lines.append(struct.pack("<ii", y, len(line)) + line)
    start = len(head) + 8 * height
    places = np.cumsum([start, *map(len, lines)])[:-1]
    path.write_bytes(head + struct.pack(f"<{height}Q", *places) + b"".join(lines))
    return path


TAPS = (0.002128, -0.007540, 0.019597, -0.043159, 0.087929, -0.186077, 0.627123)


def between(samples: np.ndarray) -> np.ndarray:
    """ImfRgbaYca.cpp's filter for one row or column, sample by sample, in float64."""
    last = len(samples) - 1
    whole = np.empty(2 * len(samples))
    whole[::2] = samples
    for k in range(len(samples)):
        whole[2 * k + 1] = sum(
            weight * (samples[max(k - 6 + n, 0)] + samples[min(k + 7 - n, last)])
            for n, weight in enumerate(TAPS)
        )
    return whole


def test_luminance_and_chroma_as_openexr_reconstructs_them(tmp_path: Path) -> None:
    rows, columns = np.mgrid[:32, :64] / 10
    smooth = np.stack(
        [1 + 0.2 * np.sin(rows), 1 + 0.2 * np.cos(columns), 1 + 0.2 * np.sin(columns - rows)], -1
    )
    weights = to_xyz("rec709")[1]
    y = (smooth @ weights).astype(np.float16)
    chroma = [
        ((smooth[::2, ::2, k] - y[::2, ::2]) / y[::2, ::2]).astype(np.float16) for k in (0, 2)
    ]
    channels = {"Y": (y, 1, 1), "RY": (chroma[0], 2, 2), "BY": (chroma[1], 2, 2)}
    pixels, notes = read_exr(write_subsampled(tmp_path / "a.exr", channels), None)
    assert notes == []
    y = y.astype(np.float64)
    red, blue = (
        np.stack([between(c) for c in np.stack([between(r) for r in each.astype(float)]).T]).T
        for each in chroma
    )
    r, b = (red + 1) * y, (blue + 1) * y
    g = (y - weights[0] * r - weights[2] * b) / weights[1]
    np.testing.assert_allclose(pixels, np.stack([r, g, b], -1), rtol=2e-5)
    # and that is the picture: half precision, and what a filter of 13 taps loses at the border
    np.testing.assert_allclose(pixels[8:-8, 8:-8], smooth[8:-8, 8:-8], rtol=4e-3)


def test_a_lamp_makes_no_negative_light_around_it(tmp_path: Path) -> None:
    """Filtered chroma rings; the luminance of each pixel is kept."""
    y = np.ones((16, 32), np.float16)
    red, blue = np.zeros((8, 16), np.float16), np.zeros((8, 16), np.float16)
    y[8, 16], red[4, 8], blue[4, 8] = 900, 3, -1
    channels = {"Y": (y, 1, 1), "RY": (red, 2, 2), "BY": (blue, 2, 2)}
    pixels, _ = read_exr(write_subsampled(tmp_path / "a.exr", channels), None)
    assert pixels.min() >= 0
    np.testing.assert_allclose(pixels @ to_xyz("rec709")[1], y, rtol=1e-3)
    np.testing.assert_array_equal(pixels[0], np.ones((32, 3)))  # greys are exact


def test_subsampled_colours_are_refused(tmp_path: Path) -> None:
    half = some_light(size=(4, 16))
    channels = {name: (half[..., k], 1, 2) for k, name in enumerate("RGB")}
    with pytest.raises(InputError, match="subsampled"):
        read_linear(write_subsampled(tmp_path / "a.exr", channels))
