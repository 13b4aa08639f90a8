"""Every layout of the pictures that people have, in both depths: the same picture in all."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import tifffile
import torch
from PIL import Image

from skylight.errors import DependencyError, InputError
from skylight.imaging._photo import PHOTO_SUFFIXES, read_photo
from skylight.imaging._pictures import picture_size, stored_picture
from tests.imaging.picture_files import as_depth, camera_exif, scene, write_png

SCENE, HALF = scene(), 128 / 255
GREY = SCENE[..., [1, 1, 1]]
DEPTHS = pytest.mark.parametrize("depth", [8, 16])
Writer = Callable[[Path, np.ndarray], None]


def _alpha(codes: np.ndarray, *, premultiplied: bool = False) -> np.ndarray:
    """With an alpha of a half, multiplied in or not."""
    largest = np.iinfo(codes.dtype).max
    alpha = np.full((*codes.shape[:2], 1), round(largest * HALF), codes.dtype)
    colour = np.rint(codes * HALF).astype(codes.dtype) if premultiplied else codes
    return np.concatenate([colour, alpha], -1)


def _tiff(**options: object) -> Writer:
    """``straight`` and ``premultiplied`` add alpha, ``planar`` has a plane for each channel."""
    order = "<>"[bool(options.pop("big_endian", False))]
    big = bool(options.pop("bigtiff", False))
    kind = options.pop("alpha", None)
    planar = options.pop("planar", False)

    def write(path: Path, codes: np.ndarray) -> None:
        if kind:
            codes = _alpha(codes, premultiplied=kind == "assocalpha")
            options["extrasamples"] = [kind]
        if planar:
            codes = np.moveaxis(codes, -1, 0)
        with tifffile.TiffWriter(path, byteorder=order, bigtiff=big) as file:
            settings = {"photometric": "rgb", "planarconfig": ("contig", "separate")[planar]}
            file.write(codes, **(settings | options))

    return write


def _by_openimageio(**attributes: object) -> Writer:
    def write(path: Path, codes: np.ndarray) -> None:
        height, width, channels = codes.shape
        kind = OpenImageIO.UINT8 if codes.dtype == np.uint8 else OpenImageIO.UINT16
        spec = OpenImageIO.ImageSpec(width, height, channels, kind)
        for name, value in attributes.items():
            spec.attribute(name, value)
        out = OpenImageIO.ImageOutput.create(str(path))
        assert out.open(str(path), spec)
        assert out.write_image(codes)
        out.close()

    return write


def _with_thumbnail(first: bool) -> Writer:
    def write(path: Path, codes: np.ndarray) -> None:
        pages = [(codes, 0), (codes[::4, ::4], 1)]
        with tifffile.TiffWriter(path) as file:
            for page, kind in pages[::-1] if first else pages:
                file.write(page, photometric="rgb", subfiletype=kind)

    return write


def _five_channels(path: Path, codes: np.ndarray) -> None:
    *colours, alpha = np.moveaxis(_alpha(codes, premultiplied=True), -1, 0)
    channels = np.stack([*colours, codes[..., 0] // 3, alpha], -1)
    tifffile.imwrite(path, channels, photometric="rgb", extrasamples=[0, 1])


LAYOUTS: dict[str, tuple[str, Writer]] = {
    "chunky": (".tif", _tiff()),
    "big-endian": (".tif", _tiff(big_endian=True)),
    "planar": (".tif", _tiff(planar=True)),
    "planar big-endian": (".tif", _tiff(planar=True, big_endian=True)),
    "planar deflate": (".tif", _tiff(planar=True, compression="zlib", predictor=True)),
    "tiles": (".tif", _tiff(tile=(16, 32))),
    "planar tiles": (".tif", _tiff(tile=(16, 32), planar=True)),
    "bigtiff": (".tiff", _tiff(bigtiff=True)),
    "bigtiff big-endian": (".tiff", _tiff(bigtiff=True, big_endian=True)),
    "straight": (".tif", _tiff(alpha="unassalpha")),
    "straight planar": (".tif", _tiff(alpha="unassalpha", planar=True)),
    "premultiplied": (".tif", _tiff(alpha="assocalpha")),
    "premultiplied planar": (".tif", _tiff(alpha="assocalpha", planar=True)),
    "a fourth channel of no meaning": (".tif", _tiff(alpha="unspecified")),
    "premultiplied behind a channel of no meaning": (".tif", _five_channels),
    "lzw": (".tif", _by_openimageio(compression="lzw")),
    "packbits": (".tif", _by_openimageio(compression="packbits")),
    "deflate": (".tif", _by_openimageio(compression="zip")),
    "planar lzw": (".tif", _by_openimageio(compression="lzw", planarconfig="separate")),
    "thumbnail first": (".tif", _with_thumbnail(True)),
    "thumbnail last": (".tif", _with_thumbnail(False)),
    "png": (".png", write_png),
    "png interlaced": (".png", lambda p, c: write_png(p, c, interlaced=True)),
    "png alpha": (".png", lambda p, c: write_png(p, _alpha(c))),
    "png alpha interlaced": (".png", lambda p, c: write_png(p, _alpha(c), interlaced=True)),
    "named as another kind": (".jpg", _tiff(planar=True)),
}
GREYS: dict[str, tuple[str, Writer]] = {
    "black is 0": (".tif", _tiff(photometric="minisblack")),
    "white is 0": (".tif", lambda p, c: _tiff(photometric="miniswhite")(p, ~c)),
    "white is 0, big-endian": (
        ".tif",
        lambda p, c: _tiff(photometric="miniswhite", big_endian=True)(p, ~c),
    ),
    "white is 0, deflate": (
        ".tif",
        lambda p, c: _tiff(photometric="miniswhite", compression="zlib")(p, ~c),
    ),
    "png": (".png", write_png),
    "png interlaced": (".png", lambda p, c: write_png(p, c, interlaced=True)),
}
GREYS_WITH_ALPHA: dict[str, tuple[str, Writer]] = {
    "straight": (".tif", _tiff(photometric="minisblack", alpha="unassalpha")),
    "premultiplied": (".tif", _tiff(photometric="minisblack", alpha="assocalpha")),
    "png": (".png", lambda p, c: write_png(p, _alpha(c))),
}


@DEPTHS
@pytest.mark.parametrize("name", LAYOUTS)
def test_colour(tmp_path: Path, name: str, depth: int) -> None:
    suffix, write = LAYOUTS[name]
    path = tmp_path / f"a{suffix}"
    write(path, as_depth(SCENE, depth))
    photo = read_photo(path)
    # 8-bit codes times a half are rounded: by half a code, doubled
    off = 1 if depth == 8 and name.startswith("premultiplied") else 0
    assert np.abs(photo.encoded.astype(int) - SCENE).max() <= off
    assert not photo.grey
    assert not photo.clipped.any()


@DEPTHS
@pytest.mark.parametrize("name", [*GREYS, *(f"{each} alpha" for each in GREYS_WITH_ALPHA)])
def test_grey(tmp_path: Path, name: str, depth: int) -> None:
    has_alpha = name.endswith(" alpha")
    suffix, write = GREYS_WITH_ALPHA[name.removesuffix(" alpha")] if has_alpha else GREYS[name]
    path, codes = tmp_path / f"a{suffix}", as_depth(SCENE[..., 1], depth)
    write(path, codes[..., None] if has_alpha else codes)
    photo = read_photo(path)
    off = 1 if depth == 8 and name.startswith("premultiplied") else 0
    assert np.abs(photo.encoded.astype(int) - GREY).max() <= off
    assert photo.grey


@pytest.mark.parametrize("depth", [8, 16])
def test_where_premultiplied_alpha_is_0_the_stored_colour_stays(tmp_path: Path, depth: int) -> None:
    codes = _alpha(as_depth(SCENE, depth), premultiplied=True)
    codes[:10] = 0
    tifffile.imwrite(tmp_path / "a.tif", codes, photometric="rgb", extrasamples=["assocalpha"])
    encoded = read_photo(tmp_path / "a.tif").encoded
    assert (encoded[:10] == 0).all()
    assert np.abs(encoded[10:].astype(int) - SCENE[10:]).max() <= 1


@DEPTHS
@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_orientation(tmp_path: Path, orientation: int, suffix: str, depth: int) -> None:
    """As EXIF 2.32 words it: which sides of the picture row 0 and column 0 are."""
    sides = {
        1: ("top", "left"), 2: ("top", "right"), 3: ("bottom", "right"), 4: ("bottom", "left"),
        5: ("left", "top"), 6: ("right", "top"), 7: ("right", "bottom"), 8: ("left", "bottom"),
    }  # fmt: skip
    row, column = sides[orientation]
    stored = SCENE if row in ("top", "bottom") else SCENE.swapaxes(0, 1)
    stored = stored[::-1] if row in ("bottom", "right") else stored
    stored = stored[:, ::-1] if column in ("bottom", "right") else stored
    codes = np.ascontiguousarray(as_depth(stored, depth))
    path = tmp_path / f"a{suffix}"
    if suffix == ".png":
        block = camera_exif(orientation=orientation).tobytes()[6:]
        write_png(path, codes, chunks={b"eXIf": block})
    else:
        _by_openimageio(Orientation=orientation)(path, codes)
    np.testing.assert_array_equal(read_photo(path).encoded, SCENE)
    assert picture_size(path) == stored.shape[1::-1]


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("planar", [False, True])
def test_floating_point_is_linear_light(tmp_path: Path, kind: type, planar: bool) -> None:
    light = (SCENE / np.float64(64)).astype(kind)  # up to 3.6: a multiple of 1 / 64 is exact
    light[0, 0] = (-0.25, 1, 2)
    _tiff(planar=planar)(tmp_path / "a.tif", light)
    photo = read_photo(tmp_path / "a.tif")
    np.testing.assert_array_equal(photo.pixels, light.clip(0))
    assert photo.encoded.max() == 255
    light[3, 3] = np.nan
    _tiff(planar=planar)(tmp_path / "nan.tif", light)
    with pytest.raises(InputError, match="NaN"):
        read_photo(tmp_path / "nan.tif")
    codes = (SCENE / 255).astype(np.float32)
    _tiff(planar=planar)(tmp_path / "codes.tif", codes)
    encoded = read_photo(tmp_path / "codes.tif", decode="srgb").pixels
    torch.testing.assert_close(encoded, read_photo(write_png(tmp_path / "a.png", SCENE)).pixels)


@pytest.mark.parametrize("factor", [256, 257])
def test_colour_maps_hold_8_bits_times_either_factor(tmp_path: Path, factor: int) -> None:
    colours = np.random.default_rng(0).integers(0, 256, (3, 256)).astype(np.uint16)
    numbers = SCENE[..., 0]
    tifffile.imwrite(tmp_path / "a.tif", numbers, photometric="palette", colormap=factor * colours)
    expected = np.moveaxis(colours[:, numbers], 0, -1)
    np.testing.assert_array_equal(read_photo(tmp_path / "a.tif").encoded, expected)


def test_integers_of_32_bits_are_codes(tmp_path: Path) -> None:
    _tiff()(tmp_path / "a.tif", SCENE.astype(np.uint32) * 16843009)
    np.testing.assert_array_equal(read_photo(tmp_path / "a.tif").encoded, SCENE)


def _zstd(path: Path, depth: int) -> None:
    """A TIFF that says zstd; what a wheel of Pillow writes in 8 bits."""
    if depth == 8:
        Image.fromarray(SCENE).save(path, compression="zstd")
        return
    _tiff()(path, as_depth(SCENE, 16))
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages[0].tags["Compression"].overwrite(50000)


def test_zstd_is_read_in_8_bits_and_named_in_16(tmp_path: Path) -> None:
    _zstd(tmp_path / "8.tif", 8)
    np.testing.assert_array_equal(read_photo(tmp_path / "8.tif").encoded, SCENE)
    _zstd(tmp_path / "16.tif", 16)
    with pytest.raises(InputError, match="16 bits compressed by zstd is not read"):
        read_photo(tmp_path / "16.tif")


def _two_pages(path: Path) -> None:
    with tifffile.TiffWriter(path) as file:
        file.write(SCENE, photometric="rgb")
        file.write(SCENE[:, ::-1], photometric="rgb")


def _cut(path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 65536, (48, 64, 3), dtype=np.uint16)
    _tiff()(path, noise)
    path.write_bytes(path.read_bytes()[:-9000])


def _grey_and_more(path: Path, depth: int) -> None:
    extra = {"photometric": "minisblack", "extrasamples": [0, 0]}
    tifffile.imwrite(path, as_depth(SCENE, depth), **extra)


REFUSED: dict[str, tuple[Callable[[Path], object], str]] = {
    "pages": (_two_pages, "several pictures"),
    "signed": (lambda p: _tiff()(p, SCENE.astype(np.int16)), "its values are int16"),
    "separated": (lambda p: Image.fromarray(SCENE).convert("CMYK").save(p), "are CMYK"),
    "lab": (lambda p: Image.fromarray(SCENE).convert("LAB").save(p), "are LAB"),
    "64 bits": (lambda p: _tiff()(p, SCENE.astype(np.uint64)), "a kind of TIFF that is not read"),
    "grey and more": (lambda p: _grey_and_more(p, 8), "it is grey and has further channels"),
    "grey and more, 16": (lambda p: _grey_and_more(p, 16), "it is grey and has further channels"),
    "negative light": (
        lambda p: _tiff(photometric="miniswhite")(p, SCENE[..., 0] / np.float32(255)),
        "white as 0 is not read",
    ),
    "bitmap": (lambda p: Image.fromarray(SCENE).convert("1").save(p), "one bit a pixel"),
    "iccLab": (lambda p: _tiff(photometric="icclab")(p, SCENE), "a kind of TIFF that is not read"),
    "deep YCbCr": (
        lambda p: _tiff(photometric="ycbcr")(p, as_depth(SCENE, 16)),
        "a kind of TIFF that is not read",
    ),
    "cut": (_cut, "damaged or cut short"),
    "header": (lambda p: p.write_bytes(b"II*\0\x08\0\0\0"), "damaged or cut short"),
    "pipe": (os.mkfifo, "it is a device or a pipe, not a file"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_told_by_its_reason(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, reason = REFUSED[name]
    make(tmp_path / "a.tif")
    with pytest.raises(InputError, match=reason) as error:
        read_photo(tmp_path / "a.tif")
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_heic_and_avif(tmp_path: Path) -> None:
    """HEIC is turned as its own properties say, which EXIF only repeats (ISO/IEC 23008-12)."""
    pytest.importorskip("pillow_heif").register_heif_opener()
    for name, upright in {"a.heic": SCENE, "b.avif": np.rot90(SCENE, 3)}.items():
        exif = camera_exif(orientation=6)
        Image.fromarray(SCENE).save(tmp_path / name, quality=95, exif=exif)
        # both are lossy, and halve the colours' resolution
        photo = read_photo(tmp_path / name)
        assert np.abs(photo.encoded - upright.astype(float)).mean() < 4


def test_without_its_library_heic_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    (tmp_path / "a.jpg").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(64))
    with pytest.raises(DependencyError, match=r"a HEIC picture needs pillow_heif.*\[heif\]"):
        read_photo(tmp_path / "a.jpg")


def test_folders_are_looked_through_for_whatever_is_read(tmp_path: Path) -> None:
    image = Image.fromarray(SCENE)
    for suffix in (".jpg", ".jpeg", ".jfif", ".png", ".tif", ".tiff", ".webp", ".bmp", ".avif"):
        assert suffix in PHOTO_SUFFIXES
        image.save(tmp_path / f"a{suffix}")
        with stored_picture(tmp_path / f"a{suffix}") as picture:
            assert (picture.width, picture.height, picture.depth) == (64, 48, 8)
    assert {".heic", ".heif", ".hif"} < PHOTO_SUFFIXES
