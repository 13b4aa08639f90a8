"""Light from files: repaired where that is asked for, and from TIFF files of float samples."""

import logging
import os
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO
import pytest
import tifffile

from skylight.errors import InputError
from skylight.io._files import read_environment_map
from skylight.io._light import read_linear, read_radiances


def write(path: Path, pixels: np.ndarray) -> Path:
    plain = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(plain, {"RGB": pixels}).write(str(path))
    return path


def some_map() -> np.ndarray:
    return np.random.default_rng(0).uniform(1, 2, (16, 32, 3)).astype(np.float32)


def test_a_few_bad_pixels_are_repaired_on_demand(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    light = some_map()
    bad = light.copy()
    bad[5, 31] = np.nan
    bad[6:9, 10:13] = np.nan
    bad[2, 3, 0] = np.inf
    bad[9, 9, 2] = -1e-3
    path = write(tmp_path / "a.exr", bad)
    with pytest.raises(InputError, match=r"10 NaN, 1 infinite, 1 negative.*--repair"):
        read_environment_map(path)
    with caplog.at_level(logging.WARNING):
        got = read_environment_map(path, repair=True).radiance.numpy()
    assert "repaired" in caplog.text
    assert got[2, 3].tolist() == [65504, *light[2, 3, 1:]]
    assert got[9, 9].tolist() == [*light[9, 9, :2], 0]
    # of the hole in the last column: columns go round
    square = np.delete(light[4:7, [30, 31, 0]].reshape(9, 3), 4, axis=0)
    np.testing.assert_allclose(got[5, 31], square.mean(0), rtol=1e-6)
    # the middle of the larger hole is filled from the next larger square
    assert 1 < got[7, 11].min() < got[7, 11].max() < 2
    kept = np.ones((16, 32), bool)
    kept[[5, 2, 9], [31, 3, 9]] = kept[6:9, 10:13] = False
    np.testing.assert_array_equal(got[kept], light[kept])


def test_holes_in_the_dark_are_dark_whatever_shines_elsewhere(tmp_path: Path) -> None:
    bad = some_map()
    bad[1:3, 2:20] = np.random.default_rng(1).uniform(0, 8e34, (2, 18, 3))
    bad[5:12] = 0
    bad[8, ::2] = np.nan
    got = read_radiances(write(tmp_path / "a.exr", bad), repair=True)
    assert got.min() == 0
    assert got[8].max() < 1e-15 * bad[1:3].max()


def test_what_is_too_much_to_repair(tmp_path: Path) -> None:
    many, negative = some_map(), some_map()
    many[:2] = np.nan
    negative[3, 3, 1] = -1
    infinite = some_map()
    infinite[3, 3, 1] = -np.inf
    for pixels, what in (
        (many, "too many"),
        (negative, "too negative"),
        (infinite, "too negative"),
    ):
        with pytest.raises(InputError, match=what):
            read_radiances(write(tmp_path / "a.exr", pixels), repair=True)


def write_tiff(path: Path, pixels: np.ndarray, kind: str, **attributes: object) -> Path:
    out = OpenImageIO.ImageOutput.create(str(path))
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    for name, value in attributes.items():
        spec.attribute(name.replace("_", ":"), value)
    out.open(str(path), spec)
    out.write_image(pixels)
    out.close()
    return path


@pytest.mark.parametrize("kind", ["half", "float", "double"])
@pytest.mark.parametrize("planes", ["contig", "separate"])
def test_float_tiff(tmp_path: Path, kind: str, planes: str) -> None:
    light = some_map().astype(np.float16).astype(np.float32)
    light[2, 3] = 900
    path = write_tiff(tmp_path / "a.tif", light, kind, planarconfig=planes)
    np.testing.assert_array_equal(read_environment_map(path).radiance, light)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientations_of_tiff(tmp_path: Path, orientation: int) -> None:
    """TIFF 6.0: where row 0 and column 0 of what is stored are seen."""
    light = some_map()
    seen = {
        1: light, 2: light[:, ::-1], 3: light[::-1, ::-1], 4: light[::-1],
        5: light.transpose(1, 0, 2), 6: np.rot90(light, 1),
        7: np.rot90(light, 2).transpose(1, 0, 2), 8: np.rot90(light, -1),
    }  # fmt: skip
    stored = np.ascontiguousarray(seen[orientation])
    path = write_tiff(tmp_path / "a.tiff", stored, "float", Orientation=orientation)
    np.testing.assert_array_equal(read_linear(path), light)


@pytest.mark.parametrize("kind", [0, 1])
def test_alpha_of_tiff_is_said_and_darkens_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: int
) -> None:
    light = some_map()
    stored = np.concatenate([light, np.full((16, 32, 1), 0.5, np.float32)], -1)
    path = write_tiff(tmp_path / "a.tif", stored, "float", oiio_UnassociatedAlpha=kind)
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(read_linear(path), light)
    assert "512 pixel(s) are half transparent" in caplog.text


def test_grey_tiff(tmp_path: Path) -> None:
    grey = some_map()[..., :1].copy()
    path = write_tiff(tmp_path / "a.tif", grey, "float")
    np.testing.assert_array_equal(read_linear(path), np.repeat(grey, 3, -1))


def test_the_picture_of_a_tiff_is_read_not_its_thumbnail(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    light, profile = some_map(), b"a profile without a name".ljust(128, b"\0")
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(light[::4, ::4], photometric="rgb", subfiletype=1)
        file.write(light, photometric="rgb", iccprofile=profile)
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(read_linear(tmp_path / "a.tif"), light)
    assert "its colour profile is not used" in caplog.text
    with tifffile.TiffWriter(tmp_path / "a.tif", append=True) as file:
        file.write(light, photometric="rgb")
    with pytest.raises(InputError, match="several pictures"):
        read_linear(tmp_path / "a.tif")


def test_what_is_said_can_be_printed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    channels = {
        f"{name}.{c}": some_map()[..., 0].copy() for name in ("\x1b[31m", "rgb") for c in "RGB"
    }
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(tmp_path / "a.exr"))
    with caplog.at_level(logging.WARNING):
        read_linear(tmp_path / "a.exr")
    assert "its layer rgb is read" in caplog.text
    assert "\x1b" not in caplog.text


def test_codes_in_a_tiff_are_no_light(tmp_path: Path) -> None:
    codes = (some_map() * 100).astype(np.uint8)
    with pytest.raises(InputError, match="uint8 codes, not of light") as error:
        read_linear(write_tiff(tmp_path / "a.tif", codes, "uint8"))
    assert "damaged" not in str(error.value)


def test_a_pipe_is_called_one(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.exr")
    with pytest.raises(InputError, match="device or a pipe"):
        read_linear(tmp_path / "pipe.exr")
