"""Photographs in every form, and time, place and heading: used, doubted, private."""

import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from PIL import ExifTags, Image
from skimage.data import astronaut, camera

from skylight._names import LightName
from skylight._options import taken_by_hand
from skylight.cli import main
from skylight.errors import InputError
from skylight.estimation import _settings
from skylight.estimation._folder import estimate_folder
from skylight.estimation._photos import Pictures, estimate
from skylight.estimation._report import write_results
from skylight.estimation._settings import EstimateSettings
from skylight.estimation._summary import PhotoEstimate, describe, summary
from skylight.faces._fit import camera_project
from skylight.faces._model import HeadModel
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.imaging._colour import srgb_to_linear
from skylight.imaging._exposure import CameraExposure
from skylight.imaging._photo import photo_from_codes, read_photo
from skylight.io._files import read_environment_map
from skylight.io._hdr import write_exr
from skylight.skies._sun import Place, sun_angles
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.studio.tasks import _light as studio
from tests.sunny_face import sunny_estimate, sunny_face

SH9 = EstimateSettings(light="sh9", device="cpu")
LATITUDE, LONGITUDE = 41.8911, 12.4922
# the face's sun is 40 degrees right of ahead, 50 from the zenith: the morning when it is so high
MORNING = datetime(2024, 6, 1, 7, 25, tzinfo=UTC)
PRIVATE = ("2024", "41.8", "12.49", "+02:00")


def right_heading_deg() -> float:
    place = Place(latitude_deg=LATITUDE, longitude_deg=LONGITUDE)
    azimuth, zenith = sun_angles(place, [MORNING])
    assert float(zenith[0]) == pytest.approx(0.87, abs=0.05)  # 50 degrees
    return (float(azimuth[0]) * 57.29578 - 40) % 360


def photo(path: Path, **tags: Any) -> Path:
    data = Image.Exif()
    inner, gps = data.get_ifd(ExifTags.IFD.Exif), data.get_ifd(ExifTags.IFD.GPSInfo)
    local = MORNING + timedelta(hours=2)
    inner[ExifTags.Base.DateTimeOriginal] = local.strftime("%Y:%m:%d %H:%M:%S")
    inner[ExifTags.Base.OffsetTimeOriginal] = "+02:00"
    known = {
        "GPSLatitudeRef": "N",
        "GPSLatitude": (41.0, 53.0, 27.96),
        "GPSLongitudeRef": "E",
        "GPSLongitude": (12.0, 29.0, 31.92),
        "GPSImgDirectionRef": "T",
        "GPSImgDirection": right_heading_deg(),
    }
    for name, value in (known | tags).items():
        (gps if name.startswith("GPS") else inner)[
            (ExifTags.GPS if name.startswith("GPS") else ExifTags.Base)[name]
        ] = value
    Image.fromarray(sunny_face(40.0, 50.0).encoded).save(path, exif=data, quality=95)
    return path


@pytest.fixture(scope="module")
def taken_photo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return photo(tmp_path_factory.mktemp("taken") / "a.jpg")


@pytest.fixture(scope="module")
def found(taken_photo: Path) -> PhotoEstimate:
    return Pictures.of([taken_photo], SH9).estimate()


def told(out: Path) -> dict[str, Any]:
    return json.loads((out / "estimate.json").read_text())


def estimated(path: Path, *options: str, light: str = "sh9") -> dict[str, Any]:
    out = path.parent / "out"
    assert main(["estimate", str(path), "--light", light, "--out", str(out), *options]) == 0
    return told(out)


def test_exif_data_tell_of_the_sun_and_results_not_of_the_place(
    found: PhotoEstimate, taken_photo: Path, tmp_path: Path
) -> None:
    write_results(tmp_path, found)
    content = told(tmp_path)
    assert content["posterior"]["clock_wrong"] < 0.3
    # harmonics are too smooth for the sun, and a line says so
    assert [line for line in content["advice"] if "re-rendered" not in line] == []
    private = (LATITUDE, LONGITUDE, right_heading_deg())
    for leaf in leaves(content):
        if isinstance(leaf, str):
            text = leaf.replace(str(taken_photo), "")
            assert not [word for word in PRIVATE if word in text], text
        elif isinstance(leaf, float):
            assert min(abs(leaf - one) for one in private) > 1e-4
    for name in ("probe.exr", "posterior.exr"):
        header = str(OpenEXR.File(str(tmp_path / name)).header())
        assert not [word for word in PRIVATE if word in header]
    assert b"2024" not in (tmp_path / "probe.hdr").read_bytes()[:200]
    with Image.open(tmp_path / "report.png") as report:
        assert not report.getexif()
        assert not [word for word in PRIVATE if word in str(report.info)]


def test_the_maps_unit_is_told_in_candela_where_the_camera_tells(
    found: PhotoEstimate, tmp_path: Path
) -> None:
    assert describe(found, keep_place=False)["luminance"] is None
    assert "unit        unknown: the photograph's data lack" in summary(found)
    exposure = CameraExposure(seconds=1 / 125, aperture=4.0, iso=200.0)
    exposed = replace(found, photos=(replace(found.photos[0], camera_exposure=exposure),))
    assert "unit        1 in the map is about 690 cd/m², within a stop" in summary(exposed)
    write_results(tmp_path, exposed)
    value = 12.5 * 16 * 125 / 200 / 0.18
    unit = told(tmp_path)["luminance"]
    assert unit["cd_per_m2"] == pytest.approx(value)
    assert unit["uncertainty_stops"] == 1
    header = OpenEXR.File(str(tmp_path / "probe.exr")).header()
    assert header["whiteLuminance"] == pytest.approx(value)
    settings = [header[name] for name in ("expTime", "aperture", "isoSpeed")]
    assert settings == pytest.approx([1 / 125, 4, 200])
    # the map's own scale is as it was
    after = read_environment_map(tmp_path / "probe.exr").radiance
    assert torch.equal(after, found.probe.radiance)


def leaves(content: Any) -> Iterator[Any]:
    """All that is not a list or a dict."""
    if isinstance(content, dict):
        content = [*content, *content.values()]
    if not isinstance(content, list):
        yield content
        return
    for part in content:
        yield from leaves(part)


def test_they_are_ignored_on_request(taken_photo: Path) -> None:
    assert Pictures.of([taken_photo], SH9).sun_prior is not None
    ignored = Pictures.of([taken_photo], replace(SH9, ignore_exif_sun=True))
    assert ignored.sun_prior is None
    assert ignored.taken == CaptureMetadata()


def test_they_are_kept_on_request(found: PhotoEstimate) -> None:
    kept = describe(found, keep_place=True)["taken"]
    assert isinstance(kept, dict)
    assert datetime.fromisoformat(kept["time"]) == MORNING
    assert kept["latitude_deg"] == pytest.approx(LATITUDE)
    assert kept["longitude_deg"] == pytest.approx(LONGITUDE)
    assert kept["heading_deg"] == pytest.approx(right_heading_deg(), abs=0.01)


@pytest.mark.slow
def test_what_is_said_by_hand_overrules(
    taken_photo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    opposite = str(round((right_heading_deg() + 180) % 360))
    # harmonics do not explain the face, which is the more to say
    found = estimated(taken_photo, "--heading", opposite, light="autoencoder")
    assert found["verdict"]["direction"]["reason"] == "the face and the clock disagree"
    assert "the face and the clock disagree" in capsys.readouterr().out
    night = estimated(taken_photo, "--time", "2024-06-01T23:30Z")
    assert night["posterior"]["clock_wrong"] is None
    assert [line for line in night["advice"] if "below the horizon" in line]
    south = estimated(taken_photo, "--place=-33.9,151.2", "--time", "2024-06-01T02:00Z")
    assert south["posterior"]["clock_wrong"] is not None


def test_bad_exif_is_left_out_with_a_line(tmp_path: Path) -> None:
    path = photo(
        tmp_path / "a.jpg",
        DateTimeOriginal="2024:13:01 10:00:00",
        GPSLatitude=(95.0, 0.0, 0.0),
        GPSImgDirection=720.0,
    )
    pictures, known = Pictures.of([path], SH9), sunny_estimate()
    assert pictures.sun_prior is None
    assert pictures.taken.latitude_deg is None
    advice = pictures.result(known.estimate, known.seen).estimate.advice
    lines = [line for line in advice if "impossible and was ignored" in line]
    assert len(lines) == 3


def test_half_of_what_is_needed_by_hand() -> None:
    taken = CaptureMetadata(time=datetime(2024, 6, 1, 10, tzinfo=UTC))
    pictures = Pictures.of([photo_from_codes(sunny_face(40.0, 50.0).encoded)], SH9, taken=taken)
    assert [line for line in pictures.notes if "without the picture's place" in line]
    assert pictures.sun_prior is None


@pytest.mark.parametrize(
    ("time", "place", "heading", "what"),
    [
        ("yesterday", None, None, "is no time"),
        ("2024-06-01T10:00", None, None, "no time zone"),
        ("2024-13-01T10:00Z", None, None, "is no time"),
        (None, "Rome", None, "is no place"),
        (None, "95,0", None, "latitude 95"),
        (None, "41,12,3", None, "is no place"),
        (None, None, 720.0, "heading 720"),
    ],
)
def test_bad_facts_by_hand_are_refused(
    time: str | None, place: str | None, heading: float | None, what: str
) -> None:
    with pytest.raises(InputError, match=what):
        taken_by_hand(time, place, heading)


def test_a_bad_time_ends_the_command_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Image.fromarray(face()).save(tmp_path / "a.png")
    out = tmp_path / "out"
    assert (
        main(["estimate", str(tmp_path / "a.png"), "--out", str(out), "--time", "yesterday"]) == 2
    )
    (line,) = capsys.readouterr().err.splitlines()
    assert "--time 'yesterday' is no time" in line
    assert not out.exists()


@pytest.mark.slow
def test_each_photo_of_a_folder_has_its_own(taken_photo: Path, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(taken_photo.read_bytes())
    plain = Image.open(taken_photo)
    plain.save(tmp_path / "photos" / "b.png", exif=b"")
    entries = estimate_folder(tmp_path / "photos", tmp_path / "out", SH9)
    assert [entry.status for entry in entries] == ["done", "done"]
    assert told(tmp_path / "out" / "a_jpg")["posterior"]["clock_wrong"] is not None
    assert told(tmp_path / "out" / "b_png")["posterior"]["clock_wrong"] is None
    for name in ("manifest.jsonl", "settings.json"):
        text = (tmp_path / "out" / name).read_text()
        assert not [private for private in ("41.8", "12.49", "+02:00") if private in text]


def test_the_studio_tells_no_place(
    found: PhotoEstimate, taken_photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studio, "estimate_photo", lambda *_, **__: found)
    content = studio.estimate_light(
        str(taken_photo), "a.jpg", 10**7, str(tmp_path), 1, "sh9", tell=lambda stage, share: None
    )
    assert content["posterior"]["clock_wrong"] is not None
    assert "taken" not in content
    # harmonics are too smooth for the sun, and a line says so
    assert [line for line in content["advice"] if "re-rendered" not in line] == []


def test_from_python(taken_photo: Path) -> None:
    """What is said by hand tells what EXIF data tell."""
    by_hand = CaptureMetadata(
        time=MORNING,
        latitude_deg=LATITUDE,
        longitude_deg=LONGITUDE,
        heading_deg=right_heading_deg(),
    )
    codes = photo_from_codes(sunny_face(40.0, 50.0).encoded)
    said, recorded = Pictures.of([codes], SH9, taken=by_hand), Pictures.of([taken_photo], SH9)
    assert said.sun_prior is not None
    assert recorded.sun_prior is not None
    for one, other in zip(said.sun_prior.parts, recorded.sun_prior.parts, strict=True):
        assert one.azimuth_rad == pytest.approx(other.azimuth_rad, abs=1e-3)
        assert one.zenith_rad == pytest.approx(other.zenith_rad, abs=1e-3)


def face() -> np.ndarray:
    return sunny_face(40.0, 50.0).encoded


def likeness(one: EnvironmentMap, other: EnvironmentMap) -> float:
    """Correlation of their luminance."""
    levels = [luminance(each.radiance).flatten() for each in (one, other)]
    return float(torch.corrcoef(torch.stack(levels))[0, 1])


def test_an_ear_that_was_taken_for_a_face_is_called_so() -> None:
    """Its head, in place of that of an estimate."""
    pictures, known = (
        Pictures.of([np.repeat(camera()[..., None], 3, axis=2)], SH9),
        sunny_estimate(),
    )
    ((one, fit),) = pictures.fit_heads()
    ear = replace(known.seen[0], face=one.face, fit=fit)
    found = pictures.result(known.estimate, [ear]).estimate
    assert found.verdict.summary == "unreliable: hardly a face"
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
def test_sixteen_bits_are_the_picture_that_eight_are(name: str, tmp_path: Path) -> None:
    """What is equal before the estimate gives the same light."""
    cv2.imwrite(str(tmp_path / name), face()[..., ::-1].astype(np.uint16) * 257)
    found, plain = read_photo(tmp_path / name), photo_from_codes(face())
    np.testing.assert_array_equal(found.encoded, plain.encoded)
    torch.testing.assert_close(found.pixels, plain.pixels, rtol=1e-5, atol=1e-7)


def test_linear_pixels_give_about_the_same_light(tmp_path: Path) -> None:
    """The detector sees an .exr in another exposure, and nothing of it counts as clipped."""
    pixels = srgb_to_linear(torch.from_numpy(face()).float() / 255)
    write_exr(tmp_path / "a.exr", pixels.numpy(), half=False, header={})
    found = estimate(tmp_path / "a.exr", light="sh9").environment
    plain = sunny_estimate().estimate.environment
    assert likeness(found, plain) > 0.9
    assert float(found.radiance.mean() / plain.radiance.mean()) == pytest.approx(1, abs=0.25)


def test_a_grey_picture_gives_neutral_light_and_says_so_and_of_the_flash(tmp_path: Path) -> None:
    data = Image.Exif()
    data.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.Flash] = 1
    Image.fromarray(face()).convert("L").save(tmp_path / "a.jpg", exif=data, quality=95)
    found, plain = estimate(tmp_path / "a.jpg", light="sh9"), sunny_estimate().estimate
    assert "grey picture: the colour of the light is the priors'" in found.advice
    assert "the flash fired: part of the light comes from the camera" in found.advice
    assert not [line for line in plain.advice if "grey" in line or "flash" in line]
    radiance = found.environment.radiance
    torch.testing.assert_close(radiance[..., 0], radiance[..., 2], rtol=0.02, atol=1e-3)
    assert likeness(found.environment, plain.environment) > 0.9


def test_a_deformed_head_meets_the_inner_landmarks() -> None:
    gaps = []
    for head in ("fitted", "deformed"):
        pictures = Pictures.of([astronaut()[:256, 100:356]], replace(SH9, head=head))
        ((one, fit),) = pictures.fit_heads()
        marks = HeadModel.load().landmarks(fit.vertices)[17:]
        gap = camera_project(fit.camera, marks) - one.face.points[17:]
        gaps.append(float(np.linalg.norm(gap, axis=1).max()) / one.face.eye_distance_px)
    assert gaps[1] < 1e-3 < 0.01 < gaps[0]


def test_the_background_is_seen_once_a_photograph_or_a_line_says_why_not() -> None:
    """Two people before something to see: with the first comes what is behind both."""
    one = sunny_face(40.0, 50.0).encoded
    two = np.hstack([one, one])
    grey = np.abs(two.astype(int) - 118).max(2, keepdims=True) < 12  # behind the heads
    noise = cv2.resize(np.random.default_rng(0).uniform(0.3, 1.0, (9, 15, 3)), two.shape[1::-1])
    pictures = Pictures.of(
        (np.where(grey, two * noise, two).astype(np.uint8),), replace(SH9, face="all")
    )
    fitted = pictures.fit_heads()
    assert len(fitted) == 2
    first, second = pictures.observe(fitted, 32, specular=False, background=True)
    assert first.view.observation.background is not None
    assert second.view.observation.background is None
    assert first.view.no_background is second.view.no_background is None
    unseen = replace(first, view=replace(first.view, no_background="it is black"))
    advice = pictures.result(sunny_estimate().estimate, [unseen]).estimate.advice
    assert f"{first.name}: the background was not used: it is black" in advice
