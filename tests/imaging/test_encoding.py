"""Whatever a file says its colours with, in both depths: the light that was written comes back."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from skylight.errors import InputError
from skylight.imaging._photo import read_photo
from tests.imaging.picture_files import (
    as_depth,
    camera_exif,
    icc_profile,
    profile_of,
    scene,
    write_bitmap,
    write_png,
    write_tiff,
)

DEPTHS = pytest.mark.parametrize("depth", [8, 16])
D65 = (0.3127, 0.3290)
# half codes that JPEG of the best quality is off by: its luma and colour differences are rounded
# (0.5 + 1.772 / 2 codes), and so is each of the 64 coefficients that make a pixel
JPEG = 8
XY = {
    "rec709": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *D65),
    "p3": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, *D65),
    "adobe": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *D65),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65),
}
# XYZ under D50, as the profiles of Apple (Display P3) and Adobe (Adobe RGB 1998) have them
P3_COLORANTS = np.array(
    [[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]]
)
ADOBE_COLORANTS = np.array(
    [[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]]
)
SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def to_xyz(xy: tuple[float, ...]) -> np.ndarray:
    """SMPTE RP 177."""
    corners = np.array(xy).reshape(4, 2)
    lengths = np.column_stack([corners, 1 - corners.sum(1)]).T
    white = lengths[:, 3] / lengths[1, 3]
    return lengths[:, :3] * np.linalg.solve(lengths[:, :3], white)


def srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)


def pq(linear: np.ndarray) -> np.ndarray:
    """SMPTE ST 2084, 1 being 203 cd/m2."""
    power = (linear * 203 / 10_000) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375


def hlg(linear: np.ndarray) -> np.ndarray:
    """BT.2100, table 5; a signal of 0.75 for 1."""
    e = linear * (np.exp((0.75 - 0.55991073) / 0.17883277) + 0.28466892) / 12
    return np.where(
        e <= 1 / 12,
        np.sqrt(3 * e),
        0.17883277 * np.log(np.maximum(12 * e - 0.28466892, 1e-9)) + 0.55991073,
    )


def gamma(exponent: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda linear: linear ** (1 / exponent)


LIGHT = np.where(
    scene() > 0.04045 * 255, ((scene() / 255 + 0.055) / 1.055) ** 2.4, scene() / (255 * 12.92)
)


def encoded(
    primaries: str, curve: Callable[[np.ndarray], np.ndarray], depth: int, light: np.ndarray = LIGHT
) -> tuple[np.ndarray, np.ndarray]:
    """(codes of Rec.709 light in those primaries, the bound of what their rounding changes).

    A code's rounding moves an encoded value by half a step, that the light by the curve's steepest
    slope, and that the result by the matrix: all three are bounded here.
    """
    to_rec709 = np.linalg.solve(to_xyz(XY["rec709"]), to_xyz(XY[primaries]))
    native = np.linalg.solve(to_rec709, light.reshape(-1, 3).T).T.reshape(light.shape)
    value, largest = curve(np.maximum(native, 0)), 2**depth - 1
    codes = np.rint(largest * value).astype(np.uint8 if depth == 8 else np.uint16)
    low, high = native.min(), native.max()
    assert low >= -1e-9
    grid = np.linspace(max(low, 1e-6), high * 1.02, 4000)
    slope = (np.diff(grid) / np.diff(curve(grid))).max()
    return codes, np.abs(to_rec709).sum(1).max() * slope * 0.5 / largest * 1.1


def assert_light(path: Path, bound: float, light: np.ndarray = LIGHT, more: float = 2e-6) -> None:
    photo = read_photo(path)
    assert np.abs(photo.pixels.numpy() - light).max() <= bound + more
    shown = 255 * srgb(photo.pixels.numpy().astype(np.float64).clip(0, 1))
    np.testing.assert_allclose(photo.encoded, shown, atol=0.5 + 1e-3)


def _cicp(primaries: int, transfer: int) -> dict[bytes, bytes]:
    return {b"cICP": bytes([primaries, transfer, 0, 1])}


def _iccp(profile: bytes) -> dict[bytes, bytes]:
    return {b"iCCP": b"p\0\0" + zlib.compress(profile)}


def _gama(value: float) -> dict[bytes, bytes]:
    return {b"gAMA": struct.pack(">I", round(1e5 * value))}


def _chrm(name: str) -> dict[bytes, bytes]:
    xy = XY[name]
    return {b"cHRM": struct.pack(">8I", *(round(1e5 * v) for v in (*xy[6:], *xy[:6])))}


P3_PROFILE, SRGB = icc_profile(P3_COLORANTS, SRGB_CURVE), {b"sRGB": b"\0"}
CHUNKS = {
    "nothing": ({}, "rec709", srgb),
    "sRGB before gAMA": ({**SRGB, **_gama(1.0), **_chrm("adobe")}, "rec709", srgb),
    "gAMA of sRGB": (_gama(0.45455), "rec709", srgb),
    "gAMA 1": (_gama(1.0), "rec709", gamma(1.0)),
    "gAMA 1/1.8": (_gama(1 / 1.8), "rec709", gamma(1.8)),
    "cHRM": (_chrm("p3"), "p3", srgb),
    "gAMA and cHRM": ({**_gama(256 / 563), **_chrm("adobe")}, "adobe", gamma(563 / 256)),
    "cICP P3": (_cicp(12, 13), "p3", srgb),
    "cICP Rec.2020 linear": (_cicp(9, 8), "rec2020", gamma(1.0)),
    "cICP before iCCP": ({**_cicp(9, 13), **_iccp(P3_PROFILE)}, "rec2020", srgb),
    "cICP before sRGB": ({**_cicp(12, 13), **SRGB}, "p3", srgb),
    "PQ": (_cicp(9, 16), "rec2020", pq),
    "HLG": (_cicp(9, 18), "rec2020", hlg),
    "iCCP": (_iccp(P3_PROFILE), "p3", srgb),
    "iCCP before gAMA": ({**_iccp(P3_PROFILE), **_gama(1.0)}, "p3", srgb),
    "code points that leave it open": ({**_cicp(2, 2), **_gama(1.0)}, "rec709", gamma(1.0)),
}


@DEPTHS
@pytest.mark.parametrize("name", CHUNKS)
def test_chunks_of_png(tmp_path: Path, name: str, depth: int) -> None:
    chunks, primaries, curve = CHUNKS[name]
    codes, bound = encoded(primaries, curve, depth)
    # a profile's numbers are rounded to 2^-16, and told to five digits
    more = 1e-4 if b"iCCP" in chunks else 5e-5
    assert_light(write_png(tmp_path / "a.png", codes, chunks=chunks), bound, more=more)


@DEPTHS
@pytest.mark.parametrize("curve", ["pq", "hlg"])
def test_what_is_brighter_than_white_is_kept(tmp_path: Path, curve: str, depth: int) -> None:
    light = 3 * LIGHT
    codes, bound = encoded("rec2020", {"pq": pq, "hlg": hlg}[curve], depth, light)
    chunks = _cicp(9, {"pq": 16, "hlg": 18}[curve])
    photo = read_photo(write_png(tmp_path / "a.png", codes, chunks=chunks))
    assert np.abs(photo.pixels.numpy() - light).max() <= bound + 1e-4
    assert photo.pixels.max() > 2
    assert not photo.clipped.any()


def test_explicit_decoding_overrules_what_a_file_says(tmp_path: Path) -> None:
    codes, _ = encoded("p3", srgb, 16)
    path = write_png(tmp_path / "a.png", codes, chunks={**_cicp(12, 13), **_iccp(P3_PROFILE)})
    light = read_photo(path, decode="linear").pixels
    np.testing.assert_allclose(light, codes / 65535, rtol=1e-6)


PROFILES = {
    "Display P3": (P3_PROFILE, "p3", srgb),
    "Adobe RGB": (icc_profile(ADOBE_COLORANTS, 563 / 256), "adobe", gamma(563 / 256)),
}


def _as_tiff(path: Path, codes: np.ndarray, profile: bytes) -> None:
    tifffile.imwrite(path, codes, photometric="rgb", iccprofile=profile)


def _by_pillow(**options: object) -> Callable[[Path, np.ndarray, bytes], None]:
    return lambda path, codes, profile: Image.fromarray(codes).save(
        path, icc_profile=profile, **options
    )


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize(
    ("file", "depth", "write"),
    [
        ("a.tif", 8, _as_tiff),
        ("a.tif", 16, _as_tiff),
        ("a.png", 8, lambda p, c, profile: write_png(p, c, chunks=_iccp(profile))),
        ("a.png", 16, lambda p, c, profile: write_png(p, c, chunks=_iccp(profile))),
        ("a.webp", 8, _by_pillow(lossless=True)),
        ("a.jpg", 8, _by_pillow(quality=100, subsampling=0)),
    ],
)
def test_profiles(tmp_path: Path, name: str, file: str, depth: int, write: Callable) -> None:
    profile, primaries, curve = PROFILES[name]
    codes, bound = encoded(primaries, curve, depth)
    write(tmp_path / file, codes, profile)
    assert_light(tmp_path / file, JPEG * bound if file == "a.jpg" else bound, more=1e-4)


@DEPTHS
def test_a_profiles_table_is_interpolated(tmp_path: Path, depth: int) -> None:
    """A ``curv`` of squares, with straight lines between its 33 entries."""
    entries = np.rint(65535 * np.linspace(0, 1, 33) ** 2).astype(">u2")
    curve = b"curv" + bytes(4) + struct.pack(">I", 33) + entries.tobytes()
    rows = zip((b"rXYZ", b"gXYZ", b"bXYZ"), P3_COLORANTS.T, strict=True)
    tags = {
        name: b"XYZ " + bytes(4) + struct.pack(">3i", *(round(65536 * v) for v in column))
        for name, column in rows
    }
    profile = profile_of(b"RGB ", {**tags, **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)})
    codes, bound = encoded("p3", gamma(2.0), depth)
    # straight lines lie above a parabola by h^2 / 4 at most
    path = write_png(tmp_path / "a.png", codes, chunks=_iccp(profile))
    assert_light(path, bound, more=2 * (1 / 32) ** 2 / 4 + 1e-4)


@DEPTHS
def test_a_grey_profile_over_lab_tells_lightness(tmp_path: Path, depth: int) -> None:
    """L* of a straight curve is 100 times the code; its light from CIE 15's formula."""
    identity = b"curv" + bytes(4) + struct.pack(">I", 0)
    profile = bytearray(profile_of(b"GRAY", {b"kTRC": identity}))
    profile[20:24] = b"Lab "
    codes = as_depth(np.tile(np.arange(0, 256, 4, dtype=np.uint8), (32, 1)), depth)
    path = write_png(tmp_path / "a.png", codes, chunks=_iccp(bytes(profile)))
    lightness = 100.0 * codes / np.iinfo(codes.dtype).max
    light = np.where(lightness > 8, ((lightness + 16) / 116) ** 3, lightness * 27 / 24389)
    np.testing.assert_allclose(read_photo(path).pixels[..., 0], light, atol=1e-6)


def test_a_profiles_tables_precede_its_matrix(tmp_path: Path) -> None:
    """ICC.1:2022, 8.10; tables are told apart by what is said of 16 bits."""
    profile = icc_profile(P3_COLORANTS, 2.2)
    (count,) = struct.unpack_from(">I", profile, 128)
    entries = [struct.unpack_from(">4sII", profile, 132 + 12 * i) for i in range(count)]
    tags = {name: profile[at : at + size] for name, at, size in entries}
    deep = as_depth(scene(), 16)
    read_photo(write_png(tmp_path / "a.png", deep, chunks=_iccp(profile)))
    both = profile_of(b"RGB ", {**tags, b"A2B0": b"mft2" + bytes(60)})
    with pytest.raises(InputError, match="by tables"):
        read_photo(write_png(tmp_path / "a.png", deep, chunks=_iccp(both)))


def test_profiles_that_are_not_applied_are_named(tmp_path: Path) -> None:
    codes = scene()
    cases = {
        "for CMYK colours": profile_of(b"CMYK", {b"A2B0": b"mft2" + bytes(60)}),
        "cannot be read": b"not a profile",
    }
    for reason, profile in cases.items():
        for deep in (codes, codes.astype(np.uint16) * 257):
            path = write_png(tmp_path / "a.png", deep, chunks=_iccp(profile))
            if deep.dtype == np.uint8 or len(profile) > 128:
                with pytest.raises(InputError, match=reason):
                    read_photo(path)
    tables = profile_of(b"RGB ", {b"A2B0": b"mft2" + bytes(60)})
    deep = codes.astype(np.uint16) * 257
    with pytest.raises(InputError, match="by tables, which are applied to 8 bits alone"):
        read_photo(write_png(tmp_path / "a.png", deep, chunks=_iccp(tables)))


# ---- what cameras say by EXIF


EXIF = {
    "R03": (camera_exif(colour_space=65535, index="R03"), "adobe"),
    "R03 alone": (camera_exif(index="R03"), "adobe"),
    "ColorSpace 2": (camera_exif(colour_space=2), "adobe"),
    "R98": (camera_exif(colour_space=1, index="R98"), "rec709"),
    "uncalibrated R98": (camera_exif(colour_space=65535, index="R98"), "rec709"),
    "uncalibrated": (camera_exif(colour_space=65535), "rec709"),
}


@pytest.mark.parametrize("name", EXIF)
@pytest.mark.parametrize(
    ("file", "depth"),
    [("a.jpg", 8), ("a.webp", 8), ("a.tif", 8), ("a.tif", 16), ("a.png", 8), ("a.png", 16)],
)
def test_cameras_adobe_rgb(tmp_path: Path, name: str, file: str, depth: int) -> None:
    exif, primaries = EXIF[name]
    codes, bound = encoded(primaries, srgb if primaries == "rec709" else gamma(563 / 256), depth)
    path = tmp_path / file
    if file == "a.png":
        write_png(path, codes, chunks={b"eXIf": exif.tobytes()[6:]})
    elif file == "a.tif":
        write_tiff(path, codes, exif)
    else:
        options = {"a.jpg": {"quality": 100, "subsampling": 0}, "a.webp": {"lossless": True}}
        Image.fromarray(codes).save(path, exif=exif, **options.get(file, {}))
    assert_light(path, JPEG * bound if file == "a.jpg" else bound)


@DEPTHS
def test_tags_of_tiff(tmp_path: Path, depth: int) -> None:
    """WhitePoint and PrimaryChromaticities (TIFF 6.0, section 20), and a TransferFunction."""
    rationals = [value for v in XY["p3"] for value in (round(1e5 * v), 100_000)]
    tags = [(318, 5, 2, rationals[12:], True), (319, 5, 6, rationals[:12], True)]
    codes, bound = encoded("p3", srgb, depth)
    tifffile.imwrite(tmp_path / "a.tif", codes, photometric="rgb", extratags=tags)
    assert_light(tmp_path / "a.tif", bound, more=5e-5)
    table = np.rint(65535 * np.linspace(0, 1, 2**depth) ** 1.8).astype(np.uint16)
    tags.append((301, 3, 2**depth, table.tolist(), True))
    codes, bound = encoded("p3", gamma(1.8), depth)
    tifffile.imwrite(tmp_path / "b.tif", codes, photometric="rgb", extratags=tags)
    assert_light(tmp_path / "b.tif", bound, more=1e-4)


def test_a_bitmaps_own_primaries(tmp_path: Path) -> None:
    codes, bound = encoded("adobe", gamma(2.2), 8)
    write_bitmap(tmp_path / "a.bmp", codes, to_xyz(XY["adobe"]).T, 2.2)
    assert_light(tmp_path / "a.bmp", bound, more=5e-5)


@pytest.mark.parametrize("file", ["a.avif", "a.heic"])
def test_code_points_of_avif_and_heic(tmp_path: Path, file: str) -> None:
    """The same pixels read as sRGB, and as Display P3 once the code points say so."""
    pytest.importorskip("pillow_heif").register_heif_opener()
    path = tmp_path / file
    Image.fromarray(scene()).save(path, quality=90)
    plain = read_photo(path).pixels.numpy()
    content = path.read_bytes()
    at = content.index(b"colrnclx") + 8
    assert content[at : at + 4] == b"\0\1\0\x0d"
    path.write_bytes(content[: at + 1] + b"\x0c" + content[at + 2 :])
    matrix = np.linalg.solve(to_xyz(XY["rec709"]), to_xyz(XY["p3"]))
    expected = (plain.astype(np.float64) @ matrix.T).clip(0)
    np.testing.assert_allclose(read_photo(path).pixels, expected, atol=2e-6)
