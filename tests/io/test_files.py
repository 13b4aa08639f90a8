import errno
import json
import os
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image

from skylight.errors import InputError, OutputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.io._files import read_environment_map, write_environment_map, write_png
from skylight.skies._captures import header_date
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import pixel_from_direction

FULL, SKY = (16, 32), (8, 32)


def some_map(layout: tuple[int, int] = FULL, *, seed: int = 0) -> EnvironmentMap:
    generator = torch.Generator().manual_seed(seed)
    return EnvironmentMap(radiance=torch.rand(*layout, 3, generator=generator) ** 4 * 1e4)


def write_channels(path: Path, channels: dict[str, np.ndarray], **header: object) -> None:
    plain = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**plain, **header}, channels).write(str(path))


def as_rgb(environment: EnvironmentMap) -> np.ndarray:
    return np.ascontiguousarray(environment.radiance.numpy())


# ---- there and back


@pytest.mark.parametrize("layout", [FULL, SKY])
def test_exr_keeps_every_bit(tmp_path: Path, layout: tuple[int, int]) -> None:
    light = some_map(layout)
    write_environment_map(tmp_path / "light.exr", light)
    assert torch.equal(read_environment_map(tmp_path / "light.exr").radiance, light.radiance)
    assert os.listdir(tmp_path) == ["light.exr"]


def test_a_strided_view_is_not_scrambled(tmp_path: Path) -> None:
    stored = torch.rand(3, 32, 16).permute(2, 1, 0)
    assert not stored.is_contiguous()
    for name in ("view.exr", "view.hdr"):
        write_environment_map(tmp_path / name, EnvironmentMap(radiance=stored))
        got = read_environment_map(tmp_path / name).radiance
        torch.testing.assert_close(got, stored, atol=1 / 256, rtol=0)


def test_half_precision_rounds_to_eleven_bits(tmp_path: Path) -> None:
    light = some_map()
    write_environment_map(tmp_path / "light.exr", light, half=True)
    got = read_environment_map(tmp_path / "light.exr").radiance
    torch.testing.assert_close(got, light.radiance, rtol=2**-11, atol=6e-8)


def test_rgbe_error_is_bounded_and_unbiased(tmp_path: Path) -> None:
    light = some_map((64, 128))
    write_environment_map(tmp_path / "light.hdr", light)
    got = read_environment_map(tmp_path / "light.hdr")
    peak = light.radiance.amax(-1, keepdim=True)
    assert ((got.radiance - light.radiance).abs() <= peak / 256).all()
    assert float(got.integrate().sum() / light.integrate().sum()) == pytest.approx(1, abs=3e-4)


def test_rgbe_of_extreme_values(tmp_path: Path) -> None:
    radiance = torch.zeros(4, 8, 3)
    radiance[0, 0] = 1e38
    radiance[1, 1] = torch.tensor([1 - 1e-4, 0.5, 0.25])  # its mantissa rounds up to 256
    radiance[2, 2] = 1e-44
    write_environment_map(tmp_path / "light.hdr", EnvironmentMap(radiance=radiance))
    got = read_environment_map(tmp_path / "light.hdr").radiance
    torch.testing.assert_close(got, radiance, rtol=1 / 256, atol=1e-38)
    with pytest.raises(OutputError, match=r"3\.4e\+38"):
        write_environment_map(
            tmp_path / "light.hdr", EnvironmentMap(radiance=torch.full((4, 8, 3), 3.4e38))
        )


def test_opencvs_run_length_rgbe_is_read(tmp_path: Path) -> None:
    light = some_map()
    cv2.imwrite(str(tmp_path / "light.hdr"), as_rgb(light)[..., ::-1])
    got = read_environment_map(tmp_path / "light.hdr").radiance
    assert ((got - light.radiance).abs() <= light.radiance.amax(-1, keepdim=True) / 128).all()


def test_header_names_primaries_and_projection(tmp_path: Path) -> None:
    write_environment_map(tmp_path / "full.exr", some_map(), convention="openexr")
    header = OpenEXR.File(str(tmp_path / "full.exr")).header()
    assert header["chromaticities"] == pytest.approx(
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
    )
    assert header["envmap"] == OpenEXR.ENVMAP_LATLONG
    assert "openexr" in header["comments"]
    write_environment_map(tmp_path / "sky.exr", some_map(SKY))
    assert "envmap" not in OpenEXR.File(str(tmp_path / "sky.exr")).header()


# ---- conventions


@pytest.mark.parametrize("convention", ["openexr", "mitsuba", "threejs", "blender"])
def test_conventions_undo_themselves(tmp_path: Path, convention) -> None:
    light = some_map()
    path = tmp_path / "light.exr"
    write_environment_map(path, light, convention=convention)
    assert torch.equal(read_environment_map(path, convention=convention).radiance, light.radiance)
    assert not torch.equal(read_environment_map(path).radiance, light.radiance)


def test_openexrs_own_orientation_picture(shared_data: Path) -> None:
    """The picture draws dark half-planes through +X and +Z, which meet at the poles."""
    path = shared_data / "reference" / "openexr_OrientationLatLong_512x256.exr"
    light = read_environment_map(path, convention="openexr")
    last_rows = light.radiance[-4:].sum((0, 2))
    axes = torch.tensor(
        [[1.0, -0.05, 0.0], [0.0, -0.05, 1.0], [-1.0, -0.05, 0.0], [0.0, -0.05, -1.0]]
    )
    _, column = pixel_from_direction(axes, *light.layout)
    level = [float(torch.roll(last_rows, 8 - round(float(c)))[:16].mean()) for c in column]
    plus_x, plus_z, minus_x, minus_z = level
    assert max(plus_x, plus_z) < 0.3 * min(minus_x, minus_z)


# ---- what is read, and what is refused


def test_tiled_rgba_and_luminance_files(tmp_path: Path) -> None:
    rgb = as_rgb(some_map())
    write_channels(
        tmp_path / "tiled.exr",
        {"RGB": rgb},
        type=OpenEXR.tiledimage,
        tiles=OpenEXR.TileDescription(),
    )
    rgba = np.concatenate([rgb, np.full((*FULL, 1), np.nan, np.float32)], -1)
    write_channels(tmp_path / "rgba.exr", {"RGBA": rgba})
    write_channels(tmp_path / "y.exr", {"Y": rgb[..., 1].copy()})
    for name in ("tiled.exr", "rgba.exr"):
        np.testing.assert_array_equal(read_environment_map(tmp_path / name).radiance, rgb)
    got = read_environment_map(tmp_path / "y.exr").radiance
    np.testing.assert_array_equal(got, np.repeat(rgb[..., 1:2], 3, -1))


def one_line(error: pytest.ExceptionInfo[BaseException], path: Path) -> str:
    message = str(error.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_bad_pixels_are_counted_and_the_first_is_named(tmp_path: Path) -> None:
    rgb = as_rgb(some_map())
    rgb[3, 7, 1] = np.nan
    rgb[3, 9] = np.nan
    rgb[5, 2, 0] = np.inf
    rgb[6, 1, 2] = -1e-3
    write_channels(tmp_path / "bad.exr", {"RGB": rgb})
    with pytest.raises(InputError) as error:
        read_environment_map(tmp_path / "bad.exr")
    message = one_line(error, tmp_path / "bad.exr")
    assert "2 NaN, 1 infinite, 1 negative" in message
    assert "row 3, column 7" in message
    with pytest.raises(OutputError, match="2 NaN"):
        write_environment_map(
            tmp_path / "again.exr", EnvironmentMap(radiance=torch.from_numpy(rgb))
        )
    assert not (tmp_path / "again.exr").exists()


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.98])
def test_truncated_files(
    tmp_path: Path, suffix: str, kept: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"cut{suffix}"
    write_environment_map(path, some_map((64, 128)))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(InputError, match="damaged") as error:
        read_environment_map(path)
    one_line(error, path)
    assert capfd.readouterr() == ("", "")  # the native readers' own words stay out of the way


def test_corrupt_exr(tmp_path: Path) -> None:
    path = tmp_path / "corrupt.exr"
    smooth = torch.linspace(0, 1, 64 * 128 * 3).reshape(64, 128, 3)
    write_environment_map(path, EnvironmentMap(radiance=smooth))
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 64] = bytes(64)
    path.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_environment_map(path)


def test_files_that_are_no_environment_maps(tmp_path: Path) -> None:
    cases = {
        "square.exr": ({"RGB": np.ones((8, 8, 3), np.float32)}, {}, "8x8"),
        "depth.exr": ({"Z": np.ones(FULL, np.float32)}, {}, "channels"),
        "whole.exr": ({"RGB": np.ones((*FULL, 3), np.uint32)}, {}, "half or float"),
        "crop.exr": (
            {"RGB": np.ones((*FULL, 3), np.float32)},
            {"displayWindow": (np.array([0, 0], np.int32), np.array([63, 31], np.int32))},
            "uncropped",
        ),
    }
    for name, (channels, header, what) in cases.items():
        write_channels(tmp_path / name, channels, **header)
        with pytest.raises(InputError, match=what) as error:
            read_environment_map(tmp_path / name)
        one_line(error, tmp_path / name)


def test_paths_that_are_no_files(tmp_path: Path) -> None:
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "light.png").write_bytes(b"")
    for name, what in {
        "none.exr": "no such file",
        "folder.exr": "folder",
        "light.png": r"\.exr or \.hdr.*float",
    }.items():
        with pytest.raises(InputError, match=what):
            read_environment_map(tmp_path / name)


def test_half_overflow_is_refused_and_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / "light.exr"
    light = some_map()
    write_environment_map(path, light, half=True)
    before = path.read_bytes()
    sun = light.radiance.clone()
    sun[2, 3] = 70_000.0
    with pytest.raises(OutputError, match=r"70000.*half=False") as error:
        write_environment_map(path, EnvironmentMap(radiance=sun), half=True)
    one_line(error, path)
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="half"):
        write_environment_map(tmp_path / "light.hdr", light, half=True)


def test_real_maps_are_read(shared_data: Path) -> None:
    maps = sorted((shared_data / "hdr").glob("*.exr"))[:5]
    if not maps:
        pytest.skip("no HDR maps among the collected data")
    for path in maps:
        light = read_environment_map(path)
        assert light.layout == (256, 512)
        assert float(light.radiance.max()) > 1


def test_the_sun_of_a_real_map_stands_where_its_table_says(shared_data: Path) -> None:
    # hdr/index.csv: peak elevation 43.1 deg, 36.0 deg right of the centre
    light = read_environment_map(shared_data / "hdr" / "kloofendal_43d_clear_puresky.exr")
    x, y, z = light.brightest_direction().tolist()
    assert np.degrees(np.arcsin(y)) == pytest.approx(43.1, abs=0.5)
    assert np.degrees(np.arctan2(x, -z)) == pytest.approx(36.0, abs=0.5)


# ---- whole or not at all


class Stopped(BaseException):
    """Like KeyboardInterrupt, which pytest would take for itself."""


@pytest.mark.parametrize("stop", [Stopped, ValueError])
def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path, stop: type) -> None:
    path = tmp_path / "result.txt"
    path.write_text("good")

    def interrupted() -> None:
        with atomic_path(path) as temporary:
            assert temporary.parent == path.parent
            assert temporary.suffix == path.suffix
            temporary.write_text("ha")
            raise stop

    with pytest.raises(stop):
        interrupted()
    assert path.read_text() == "good"
    assert os.listdir(tmp_path) == ["result.txt"]


def test_no_space_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_json(tmp_path / "numbers.json", [1])
    assert os.listdir(tmp_path) == []


def test_folders_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="make the folder first"):
        write_json(tmp_path / "none" / "numbers.json", [1])
    (tmp_path / "folder.json").mkdir()
    with pytest.raises(OutputError, match="no ordinary file"):
        write_json(tmp_path / "folder.json", [1])


def test_a_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "real.json").write_text("0")
    (tmp_path / "link.json").symlink_to(tmp_path / "there" / "real.json")
    write_json(tmp_path / "link.json", {"a": 1})
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads((tmp_path / "there" / "real.json").read_text()) == {"a": 1}


def test_new_files_have_ordinary_permissions(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"name": "é"})
    (tmp_path / "b").touch()
    assert (tmp_path / "a.json").stat().st_mode == (tmp_path / "b").stat().st_mode
    assert json.loads((tmp_path / "a.json").read_text("utf-8")) == {"name": "é"}
    with pytest.raises(ValueError, match="Out of range"):
        write_json(tmp_path / "a.json", float("nan"))


def test_png_keeps_a_strided_picture(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (3, 20, 10), dtype=np.uint8).T
    write_png(tmp_path / "a.png", picture)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), picture)


def test_attributes_of_another_type_and_texts_that_are_none(tmp_path: Path) -> None:
    """As fuzzing found them."""
    whole = tmp_path / "whole.exr"
    write_environment_map(whole, some_map())
    name = b"chromaticities\0"
    for changed in (name + b"chromaticitiez\0", b"chromatic\xc3ties\0" + name):
        path = tmp_path / "changed.exr"
        path.write_bytes(whole.read_bytes().replace(name + name, changed))
        with pytest.raises(InputError, match=r"changed\.exr") as caught:
            read_environment_map(path)
        assert "\n" not in str(caught.value)
        assert header_date(path) == ""
