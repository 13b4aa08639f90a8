"""``skylight estimate`` of pictures in every form that cameras and programs write."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from skimage.data import camera

from skylight.cli import main
from skylight.estimate import _settings
from skylight.estimate._photos import estimate
from skylight.imaging._colour import srgb_to_linear
from skylight.io._files import read_environment_map
from skylight.io._hdr import write_exr
from skylight.models._names import LightName
from skylight.sphere._envmap import EnvironmentMap, luminance
from tests.sunny_face import sunny_face


def face() -> np.ndarray:
    return sunny_face(120.0, 45.0).encoded


def estimated(photo: Path) -> tuple[EnvironmentMap, list[str]]:
    """(light, advice) of the quickest model, by the command line."""
    out = photo.parent / f"{photo.name}_light"
    assert main(["estimate", str(photo), "--light", "sh9", "--out", str(out)]) == 0
    told = json.loads((out / "estimate.json").read_text())
    return read_environment_map(out / "probe.exr"), told["advice"]


def likeness(one: EnvironmentMap, other: EnvironmentMap) -> float:
    """Correlation of their luminance."""
    levels = [luminance(each.radiance).flatten() for each in (one, other)]
    return float(torch.corrcoef(torch.stack(levels))[0, 1])


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[EnvironmentMap, list[str]]:
    path = tmp_path_factory.mktemp("plain") / "a.png"
    Image.fromarray(face()).save(path)
    return estimated(path)


def _deep(path: Path) -> None:
    cv2.imwrite(str(path), face()[..., ::-1].astype(np.uint16) * 257)


def _linear(path: Path) -> None:
    pixels = srgb_to_linear(torch.from_numpy(face()).float() / 255)
    write_exr(path, pixels.numpy(), half=False, header={})


def test_an_ear_that_was_taken_for_a_face_is_called_so() -> None:
    found = estimate(np.repeat(camera()[..., None], 3, axis=2), light="sh9")
    assert found.posterior.verdict == "unreliable: hardly a face"
    (line,) = [line for line in found.advice if "hardly a face" in line]
    assert "% of the eyes' distance off the head" in line


def test_the_exposure_reaches_the_choice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = Image.Exif()
    tags = {"ExposureTime": 1 / 128, "FNumber": 16.0, "ISOSpeedRatings": 100}
    for name, value in tags.items():
        data.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base[name]] = value
    Image.fromarray(face()).save(tmp_path / "a.jpg", exif=data)
    asked: list[float] = []

    def spy(light: LightName, count: int, *, exposures: list[float], **rest: Any) -> None:
        asked.extend(exposures)
        raise StopIteration  # of the estimate no more is looked at

    monkeypatch.setattr(_settings, "light_problems", spy)
    with pytest.raises(StopIteration):
        estimate(tmp_path / "a.jpg", light="sh9")
    assert asked == [pytest.approx(15)]


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_sixteen_bits_give_the_same_light(
    name: str, plain: tuple[EnvironmentMap, list[str]], tmp_path: Path
) -> None:
    cv2.imwrite(str(tmp_path / name), face()[..., ::-1].astype(np.uint16) * 257)
    found, _ = estimated(tmp_path / name)
    torch.testing.assert_close(found.radiance, plain[0].radiance, rtol=1e-3, atol=1e-3)


def test_linear_pixels_give_about_the_same_light(
    plain: tuple[EnvironmentMap, list[str]], tmp_path: Path
) -> None:
    """The detector sees an .exr in another exposure, and nothing of it counts as clipped."""
    pixels = srgb_to_linear(torch.from_numpy(face()).float() / 255)
    write_exr(tmp_path / "a.exr", pixels.numpy(), half=False, header={})
    found, _ = estimated(tmp_path / "a.exr")
    assert likeness(found, plain[0]) > 0.9
    assert float(found.radiance.mean() / plain[0].radiance.mean()) == pytest.approx(1, abs=0.25)


def test_a_grey_picture_gives_neutral_light_and_says_so(
    plain: tuple[EnvironmentMap, list[str]], tmp_path: Path
) -> None:
    Image.fromarray(face()).convert("L").save(tmp_path / "a.png")
    found, advice = estimated(tmp_path / "a.png")
    assert "grey picture: the colour of the light is the priors'" in advice
    assert not [line for line in plain[1] if "grey" in line]
    torch.testing.assert_close(found.radiance[..., 0], found.radiance[..., 2], rtol=0.02, atol=1e-3)
    assert likeness(found, plain[0]) > 0.9


def test_a_flash_is_told(tmp_path: Path) -> None:
    data = Image.Exif()
    data.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.Flash] = 1
    Image.fromarray(face()).save(tmp_path / "a.jpg", exif=data, quality=95)
    _, advice = estimated(tmp_path / "a.jpg")
    assert "the flash fired: part of the light comes from the camera" in advice
