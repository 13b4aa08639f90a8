"""Relit portraits: the command from photograph to picture, brightness, and how they are shown."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.cli import main
from skylight.estimation._summary import PhotoEstimate
from skylight.imaging._colour import linear_to_srgb
from skylight.io._files import write_png
from skylight.io._light import read_linear
from skylight.portrait._files import (
    KNEE,
    RelitPortrait,
    relit_portrait,
    shown,
    write_relit,
)
from skylight.portrait._lights import NewLight
from skylight.portrait._relit import FaceReflection, light_in_photo, portrait_of
from skylight.sphere._envmap import EnvironmentMap
from tests.sunny_face import direction, sky_estimate, sunny_estimate, sunny_face


@pytest.fixture(scope="module")
def photo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("photo") / "me.png"
    write_png(path, sunny_face(40.0, 50.0).encoded)
    return path


def sides(path: Path) -> tuple[float, float]:
    """Mean codes of the face's left and right halves in the picture."""
    codes = np.array(Image.open(path).convert("RGB")).astype(float)
    face = codes[90:190, 78:178]
    return face[:, :40].mean(), face[:, 60:].mean()


def test_the_sun_goes_to_the_other_side(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "left.png"
    arguments = ["relight-portrait", str(photo), "--light", "sh9", "--out", str(out)]
    assert main([*arguments, "--sun=-60,40"]) == 0
    said = capsys.readouterr()
    assert "verdict" in said.out
    assert str(out) in said.out
    before, after = sides(photo), sides(out)
    assert before[1] > before[0]
    assert after[0] > after[1]


@pytest.mark.parametrize(
    "estimate", [sky_estimate, pytest.param(sunny_estimate, marks=pytest.mark.slow)]
)
def test_under_a_map_the_face_is_as_bright_as_it_was(
    estimate: Callable[[], PhotoEstimate], tmp_path: Path
) -> None:
    dim = EnvironmentMap(radiance=torch.full((32, 64, 3), 0.001))
    light = NewLight(environment=dim.with_light(direction(-50.0, 60.0), torch.full((3,), 0.004)))
    result = estimate()
    portrait = portrait_of(
        result.photos[0],
        result.fit,
        FaceReflection.of(result.estimate, result.view.observation),
        light_in_photo(result.estimate),
        face_px=60,
    )
    once, twice = (
        relit_portrait(result, light, exposure=ev, keep="brightness", portrait=portrait)
        for ev in (1.0, 2.0)
    )
    write_relit(tmp_path / "under.exr", once)
    picture = read_linear(tmp_path / "under.exr")
    old = sunny_face(40.0, 50.0).picture.numpy()
    face = np.s_[90:190, 78:178]
    assert picture[face].mean() == pytest.approx(old[face].mean(), rel=0.15)
    assert twice.picture[face].mean() / picture[face].mean() == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sun", "here"], "AZ,EL"),
        ([], "name the light: --key left"),
        (["--key", "left", "--turn", "20"], "--key and --turn"),
        (["--angle", "10,20", "--under", "a.exr"], "--angle and --under"),
        (["--angle", "10"], "AZ,EL"),
        (["--angle", "10,nan"], "AZ,EL"),
        (["--angle", "10,120"], "elevation"),
        (["--turn", "20", "--soft"], "--soft"),
        (["--sun", "20,30", "--size", "3"], "--size"),
        (["--key", "top", "--size", "0"], "wide"),
        (["--key", "top", "--strength", "-1"], "strength"),
        (["--key", "top", "--out", "nowhere/lit"], "no such folder"),
        (["--turn", "20", "--strength", "2"], "--strength"),
        (["--turn", "20", "--ev", "90"], "--ev"),
        (["--turn", "20", "--out", "x.gif"], ".png"),
        (["--turn", "nan"], "--turn"),
        (["--turn", "20", "--out", "nowhere/x.png"], "no such folder"),
        (["--under", "nowhere.exr"], "nowhere.exr"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    options: list[str],
    said: str,
    photo: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["relight-portrait", str(photo), "--light", "sunsky", *options]) in (1, 2)
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert said in line
    assert list(tmp_path.iterdir()) == []


def relit(picture: np.ndarray, photo: np.ndarray, warning: str = "") -> RelitPortrait:
    return RelitPortrait(
        picture=picture.astype(np.float32),
        photo=photo.astype(np.float32),
        exposure=1.0,
        warning=warning,
        notes=(),
    )


def test_highlights_roll_off_and_what_is_unchanged_is_as_it_was() -> None:
    photo = np.linspace(0, 1, 300).reshape(10, 10, 3)
    codes = shown(relit(photo, photo))
    want = (linear_to_srgb(torch.from_numpy(photo)) * 255).round().numpy()
    np.testing.assert_allclose(codes, want, atol=1)
    ramp = np.linspace(0, 5, 300).reshape(10, 10, 3)
    brighter = shown(relit(ramp, np.zeros_like(ramp)))
    steps = np.diff(brighter.reshape(-1).astype(int))
    assert steps.min() >= 0
    below = ramp < KNEE
    want = (linear_to_srgb(torch.from_numpy(ramp)) * 255).round().numpy()
    np.testing.assert_allclose(brighter[below], want[below], atol=1)
    assert brighter.max() == 255


def test_a_photo_in_units_of_its_own_is_shown_as_it_is_seen() -> None:
    linear = np.linspace(0, 40, 300).reshape(10, 10, 3)
    one = replace(relit(linear, linear), white=50.0)
    want = (linear_to_srgb(torch.from_numpy(linear / 50)) * 255).round().numpy()
    np.testing.assert_allclose(shown(one), want, atol=1)


def test_doubt_is_said_below_the_picture(tmp_path: Path) -> None:
    picture = np.full((80, 200, 3), 0.5)
    write_relit(tmp_path / "a.png", relit(picture, picture))
    write_relit(tmp_path / "b.png", relit(picture, picture, "the light is unreliable"))
    plain, doubtful = (np.array(Image.open(tmp_path / name)) for name in ("a.png", "b.png"))
    assert plain.shape == (80, 200, 3)
    assert doubtful.shape[0] > 90
    np.testing.assert_array_equal(doubtful[:80], plain)
    assert len(np.unique(doubtful[80:].reshape(-1, 3), axis=0)) > 5  # letters


def test_doubt_is_said_in_full_below_a_narrow_picture(tmp_path: Path) -> None:
    warning = "the light that was found is unreliable: the face is too dark to tell"
    heights = []
    for width in (100, 1000):
        picture = np.full((10, width, 3), 0.5)
        write_relit(tmp_path / "a.png", relit(picture, picture, warning))
        below = np.array(Image.open(tmp_path / "a.png"))[10:].max(2) > 128
        rows, columns = below.any(1), np.nonzero(below.any(0))[0]
        assert columns.max() < width - 2
        heights.append(int((np.diff(rows.astype(int)) == 1).sum()))
    assert heights == [5, 1]  # lines
