import math
import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from PIL import ExifTags, Image, ImageCms, ImageOps

from skylight.errors import InputError
from skylight.imaging._colour import Decode
from skylight.imaging._photo import photo_from_codes, read_photo

ORIENTATION = ExifTags.Base.Orientation


def colours(height: int = 48, width: int = 64) -> np.ndarray:
    """A smooth picture with no symmetry, so that every orientation differs."""
    y, x = np.mgrid[:height, :width]
    channels = [255 * x / width, 255 * y / height, 128 + 60 * np.sin(x * y / 200)]
    return np.stack(channels, -1).astype(np.uint8)


def saved(path: Path, picture: np.ndarray | Image.Image, **options: object) -> Path:
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    image.save(path, **options)
    return path


GREY = colours()[..., 0]


def exif(**tags: object) -> Image.Exif:
    """EXIF with the camera's tags in their own directory, as cameras write them."""
    data = Image.Exif()
    inner = data.get_ifd(ExifTags.IFD.Exif)
    for name, value in tags.items():
        inner[ExifTags.Base[name]] = value
    return data


# ---- values


def test_png_codes_become_linear_light(tmp_path: Path) -> None:
    picture = colours()
    path = saved(tmp_path / "a.png", picture)
    photo = read_photo(path)
    np.testing.assert_array_equal(photo.encoded, picture)
    code = int(picture[10, 20, 0]) / 255
    assert float(photo.pixels[10, 20, 0]) == pytest.approx(
        ((code + 0.055) / 1.055) ** 2.4, rel=1e-5
    )
    assert photo.pixels.dtype == torch.float32
    assert photo.focal_px is None


@pytest.mark.parametrize("decode", [None, "linear", 2.2])
def test_every_code_is_decoded(decode: Decode | None) -> None:
    """Pictures go through a table; the curves are written again here, in float64."""
    codes = np.stack([np.roll(np.arange(256), k).reshape(32, 8) for k in (0, 1, 2)], -1)
    codes = np.tile(codes.astype(np.uint8), (3, 4, 1))  # more rows than are decoded together
    value = codes / 255.0
    expected = {
        None: np.where(value > 0.04045, ((value + 0.055) / 1.055) ** 2.4, value / 12.92),
        "linear": value,
        2.2: value**2.2,
    }[decode]
    photo = photo_from_codes(codes, decode=decode)
    np.testing.assert_allclose(photo.pixels, expected, rtol=2e-6)
    curve = np.where(expected > 0.0031308, 1.055 * expected ** (1 / 2.4) - 0.055, 12.92 * expected)
    np.testing.assert_array_equal(photo.encoded, np.rint(255 * curve))


def test_decoding_takes_little_more_memory_than_the_photo() -> None:
    codes = np.tile(colours(), (20, 20, 1))
    tracemalloc.start()
    photo_from_codes(codes)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # 12 bytes of light, 3 of codes, 1 of mask, and what the mask is made from
    assert peak < 21 * codes.shape[0] * codes.shape[1]


def test_codes_give_the_photo_of_their_file(tmp_path: Path) -> None:
    picture = colours()
    picture[3, 4] = 255
    path = saved(tmp_path / "a.png", picture)
    for decode in (None, "linear", 1.8):
        photo, read = photo_from_codes(picture, decode=decode), read_photo(path, decode=decode)
        np.testing.assert_array_equal(photo.encoded, read.encoded)
        assert torch.equal(photo.pixels, read.pixels)
        assert torch.equal(photo.clipped, read.clipped)
        assert photo.clipped[3, 4]
        assert photo.focal_px is None


def test_black_codes_are_refused() -> None:
    with pytest.raises(InputError, match="black"):
        photo_from_codes(np.full((48, 64, 3), 1, np.uint8))


# ---- grey pictures


def _grey16(path: Path) -> None:
    cv2.imwrite(str(path), GREY.astype(np.uint16) * 257)


GREY_FILES = {
    "grey.png": lambda p: saved(p, GREY),
    "grey.tif": lambda p: saved(p, GREY),
    "alpha.png": lambda p: saved(p, Image.fromarray(GREY).convert("LA")),
    "grey16.png": _grey16,
    "grey16.tif": _grey16,
    "three.png": lambda p: saved(p, np.repeat(GREY[..., None], 3, -1)),
    "palette.png": lambda p: saved(p, Image.fromarray(GREY).convert("P")),
}


@pytest.mark.parametrize("name", GREY_FILES)
def test_grey_pictures_have_three_equal_channels(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    GREY_FILES[name](path)
    photo = read_photo(path)
    assert photo.grey
    np.testing.assert_array_equal(photo.encoded, np.repeat(GREY[..., None], 3, -1))
    value = GREY[:, 1:] / 255
    light = np.where(value > 0.04045, ((value + 0.055) / 1.055) ** 2.4, value / 12.92)
    for channel in photo.pixels[:, 1:].unbind(2):
        np.testing.assert_allclose(channel, light, rtol=2e-6)
    with pytest.raises(InputError, match="grey"):
        read_photo(path, require_colour=True)


def test_roundings_trace_of_colour_is_taken_out() -> None:
    codes = np.repeat(GREY[..., None], 3, -1)
    codes[..., 0] = np.minimum(codes[..., 0], 253) + 1
    photo = photo_from_codes(codes)
    assert photo.grey
    assert torch.equal(photo.pixels[..., 0], photo.pixels[..., 2])
    # the luminance stays: a step of one code in red
    plain = photo_from_codes(np.repeat(GREY[..., None], 3, -1)).pixels
    difference = (photo.pixels - plain)[GREY < 253]
    assert (difference > 0).all()
    assert float(difference.max()) < 0.01
    assert not photo_from_codes(colours()).grey


def test_a_grey_profile_is_converted(tmp_path: Path) -> None:
    """Luminance as it is (a gamma of 1) becomes sRGB, as the profile asks."""
    path = saved(tmp_path / "g.png", GREY, icc_profile=_linear_grey_profile())
    photo = read_photo(path)
    assert photo.grey
    bright = GREY > 60
    np.testing.assert_allclose(photo.pixels[..., 0][bright], GREY[bright] / 255, atol=0.012)


def _linear_grey_profile() -> bytes:
    """ICC.1:2001-04, the least that a monochrome input profile has."""
    curve = b"curv" + bytes(8)  # no entries: a gamma of 1
    white = b"XYZ " + bytes(4) + struct.pack(">3i", 63190, 65536, 54061)
    text = b"desc" + bytes(4) + struct.pack(">I", 2) + b"g\0" + bytes(8 + 3 + 67)
    parts, at, table = [text, white, curve], 128 + 4 + 12 * 3, b""
    for name, part in zip((b"desc", b"wtpt", b"kTRC"), parts, strict=True):
        table += name + struct.pack(">II", at, len(part))
        at += len(part)
    header = struct.pack(">I4sI4s4s4s", at, b"lcms", 0x02100000, b"mntr", b"GRAY", b"XYZ ")
    header += bytes(12) + b"acsp" + bytes(28) + struct.pack(">3i", 63190, 65536, 54061)
    return header.ljust(128, b"\0") + struct.pack(">I", 3) + table + b"".join(parts)


def test_other_encodings(tmp_path: Path) -> None:
    picture = colours()
    path = saved(tmp_path / "a.png", picture)
    codes = torch.from_numpy(picture / 255.0).float()
    torch.testing.assert_close(read_photo(path, decode="linear").pixels, codes)
    torch.testing.assert_close(read_photo(path, decode=1.8).pixels, codes**1.8)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sixteen_bits_are_kept(tmp_path: Path, suffix: str) -> None:
    picture = (colours().astype(np.uint16) << 8) + np.arange(64, dtype=np.uint16)[:, None]
    picture[0, 0] = 65535
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), picture[..., ::-1])
    photo = read_photo(path, decode="linear")
    np.testing.assert_array_equal((photo.pixels * 65535).round().numpy().astype(int), picture)
    assert photo.clipped.nonzero().tolist() == [[0, 0]]


def test_clipped_pixels_are_marked(tmp_path: Path) -> None:
    picture = np.minimum(colours(), 254)
    picture[5, 6, 1] = 255
    picture[7, 8] = 255
    photo = read_photo(saved(tmp_path / "a.png", picture))
    assert photo.clipped.nonzero().tolist() == [[5, 6], [7, 8]]


def test_transparency_and_palettes_are_read_as_colour(tmp_path: Path) -> None:
    picture = colours()
    alpha = np.concatenate([picture, np.full((48, 64, 1), 9, np.uint8)], -1)
    np.testing.assert_array_equal(read_photo(saved(tmp_path / "rgba.png", alpha)).encoded, picture)
    palette = Image.fromarray(picture).quantize(64)
    read = read_photo(saved(tmp_path / "p.png", palette)).encoded
    np.testing.assert_array_equal(read, np.asarray(palette.convert("RGB")))


def test_an_embedded_profile_is_converted(tmp_path: Path) -> None:
    """A profile with red and green exchanged (as primaries) tells conversion from neglect."""
    picture = colours()
    wide = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    srgb_tagged = read_photo(saved(tmp_path / "s.png", picture, icc_profile=wide))
    np.testing.assert_array_equal(srgb_tagged.encoded, picture)  # not even rounded

    exchanged = bytearray(wide)
    tags = {
        wide[at : at + 4]: at + 4
        for at in range(132, 132 + 12 * struct.unpack(">I", wide[128:132])[0], 12)
    }
    red, green = tags[b"rXYZ"], tags[b"gXYZ"]
    exchanged[red : red + 8], exchanged[green : green + 8] = (
        wide[green : green + 8],
        wide[red : red + 8],
    )
    path = saved(tmp_path / "x.png", picture, icc_profile=bytes(exchanged))
    photo = read_photo(path)
    error = np.abs(photo.encoded.astype(int) - picture[..., [1, 0, 2]])
    assert error.max() <= 2
    np.testing.assert_allclose(read_photo(path, decode="linear").pixels, picture / 255, atol=1e-6)

    broken = saved(tmp_path / "b.png", picture, icc_profile=b"not a profile")
    with pytest.raises(InputError, match="profile"):
        read_photo(broken)


def test_linear_exr_photo(tmp_path: Path) -> None:
    pixels = colours().astype(np.float32) / 10
    pixels[0, 0] = (-1e-3, 2, 3)
    OpenEXR.File({}, {"RGB": pixels}).write(str(tmp_path / "a.exr"))
    photo = read_photo(tmp_path / "a.exr")
    np.testing.assert_array_equal(photo.pixels, pixels.clip(0))
    assert photo.encoded.max() == 255
    assert not photo.clipped.any()
    pixels[3, 3] = np.nan
    OpenEXR.File({}, {"RGB": pixels}).write(str(tmp_path / "nan.exr"))
    with pytest.raises(InputError, match="NaN"):
        read_photo(tmp_path / "nan.exr")


# ---- orientation and focal length


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
def test_exif_orientation(tmp_path: Path, orientation: int, suffix: str) -> None:
    data = Image.Exif()
    data[ORIENTATION] = orientation
    path = saved(tmp_path / f"a{suffix}", colours(), exif=data)
    upright = ImageOps.exif_transpose(Image.open(saved(tmp_path / "b.png", colours(), exif=data)))
    got = read_photo(path).encoded.astype(int)
    assert got.shape == np.asarray(upright).shape
    assert np.abs(got - np.asarray(upright)).mean() < (4 if suffix == ".jpg" else 1e-9)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_of_sixteen_bits(tmp_path: Path, orientation: int) -> None:
    data = Image.Exif()
    data[ORIENTATION] = orientation
    eight = read_photo(saved(tmp_path / "a.png", colours(), exif=data))
    cv2.imwrite(str(tmp_path / "b.png"), colours().astype(np.uint16)[..., ::-1] * 257)
    raw, block = (tmp_path / "b.png").read_bytes(), b"eXIf" + data.tobytes()[6:]
    chunk = struct.pack(">I", len(block) - 4) + block + struct.pack(">I", zlib.crc32(block))
    (tmp_path / "b.png").write_bytes(raw[:33] + chunk + raw[33:])  # after the PNG's header
    torch.testing.assert_close(read_photo(tmp_path / "b.png").pixels, eight.pixels)


def test_focal_length_from_the_35_mm_equivalent(tmp_path: Path) -> None:
    tags = exif(FocalLengthIn35mmFilm=50)
    path = saved(tmp_path / "a.jpg", colours(48, 72), exif=tags)
    # the shape of 35 mm film: 36 mm are 72 pixels
    assert read_photo(path).focal_px == pytest.approx(100)


def test_focal_length_from_the_sensors_pitch(tmp_path: Path) -> None:
    # 10 mm at 25.4 mm / 2540 pixels: 1000 pixels of a 128-pixel row, now scaled to 64
    tags = exif(
        FocalLength=10.0, FocalPlaneXResolution=2540.0, ExifImageWidth=128, ExifImageHeight=96
    )
    path = saved(tmp_path / "a.jpg", colours(), exif=tags)
    assert read_photo(path).focal_px == pytest.approx(500)


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {"FocalLengthIn35mmFilm": 0},
        {"FocalLength": 10.0},
        {"FocalLengthIn35mmFilm": 50, "ExifImageWidth": 400, "ExifImageHeight": 100},
        {"FocalLength": math.nan, "FocalPlaneXResolution": 2540.0},
    ],
)
def test_no_focal_length_rather_than_a_wrong_one(tmp_path: Path, tags: dict) -> None:
    assert read_photo(saved(tmp_path / "a.jpg", colours(), exif=exif(**tags))).focal_px is None


# ---- refusals


def _animated(path: Path) -> None:
    frames = [Image.fromarray(np.roll(colours(), 9 * i, 1)) for i in range(3)]
    frames[0].save(path, save_all=True, append_images=frames[1:])


def _truncated(path: Path) -> None:
    Image.fromarray(colours()).save(path)
    path.write_bytes(path.read_bytes()[:-300])


def _truncated_deep(path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 65536, (48, 64, 3), dtype=np.uint16)
    cv2.imwrite(str(path), noise)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _huge(path: Path) -> None:
    """A PNG header that promises 60000 x 60000 pixels."""
    Image.fromarray(colours()).save(path)
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    path.write_bytes(data)


BAD = {
    "missing.jpg": (lambda p: None, "No such file"),
    "folder.jpg": (Path.mkdir, "directory"),
    "empty.jpg": (lambda p: p.write_bytes(b""), "no picture"),
    "text.jpg": (lambda p: p.write_text("a letter"), "no picture"),
    "cut.jpg": (_truncated, "damaged"),
    "cut.png": (_truncated, "damaged"),
    "cut16.png": (_truncated_deep, "damaged"),
    "cmyk.jpg": (lambda p: Image.fromarray(colours()).convert("CMYK").save(p), "CMYK"),
    "lab.tif": (lambda p: Image.fromarray(colours()).convert("LAB").save(p), "LAB"),
    "animated.gif": (_animated, "several pictures"),
    "animated.png": (_animated, "several pictures"),
    "pages.tif": (_animated, "several pictures"),
    "one.png": (lambda p: saved(p, colours(1, 1)), "1x1"),
    "thin.png": (lambda p: saved(p, colours(8, 64)), "64x8"),
    "long.png": (lambda p: saved(p, colours(32, 16_385)), "16385x32"),
    "huge.png": (_huge, "too large|60000x60000"),
    "bitmap.png": (lambda p: Image.fromarray(GREY).convert("1").save(p), "one bit a pixel"),
    "dark.png": (lambda p: saved(p, np.zeros((48, 64), np.uint8)), "black"),
    "black.jpg": (lambda p: saved(p, np.zeros((48, 64, 3), np.uint8)), "black"),
}


@pytest.mark.parametrize("name", BAD)
def test_unusable_pictures_end_in_one_clear_line(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, what = BAD[name]
    path = tmp_path / name
    make(path)
    with pytest.raises(InputError, match=what) as error:
        read_photo(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_a_phones_multi_picture_jpeg_is_a_photo(tmp_path: Path) -> None:
    first, second = Image.fromarray(colours()), Image.fromarray(colours(24, 32))
    path = tmp_path / "phone.jpg"
    first.save(path, format="MPO", save_all=True, append_images=[second])
    assert read_photo(path).encoded.shape == (48, 64, 3)


def test_real_photos(shared_data: Path) -> None:
    faces = sorted((shared_data / "faces").glob("*.jpg"))[:3]
    if not faces:
        pytest.skip("no face photos among the collected data")
    for path in faces:
        photo = read_photo(path)
        assert max(photo.encoded.shape) <= 1024
        assert 0 < float(photo.pixels.mean()) < 1
