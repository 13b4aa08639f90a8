"""Time, place and heading of photographs through ``skylight estimate``: used, doubted, private."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import OpenEXR
import pytest
from PIL import ExifTags, Image

import skylight
from skylight.cli import main
from skylight.estimate._folder import estimate_folder
from skylight.estimate._settings import EstimateSettings
from skylight.imaging._photo import photo_from_codes
from skylight.imaging._taken import Taken
from skylight.skies._sun import Place, sun_angles
from skylight.studio.tasks._light import estimate_light
from tests.sunny_face import sunny_face

LATITUDE, LONGITUDE = 41.8911, 12.4922
# the face's sun is 30 degrees right of ahead, 60 from the zenith: the morning when it is so high
MORNING = datetime(2024, 6, 1, 6, 40, tzinfo=UTC)
PRIVATE = ("2024", "41.8", "12.49", "+02:00")


def right_heading_deg() -> float:
    place = Place(latitude_deg=LATITUDE, longitude_deg=LONGITUDE)
    azimuth, zenith = sun_angles(place, [MORNING])
    assert float(zenith[0]) == pytest.approx(1.05, abs=0.05)  # 60 degrees
    return (float(azimuth[0]) * 57.29578 - 30) % 360


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
    Image.fromarray(sunny_face(30.0, 60.0).encoded).save(path, exif=data, quality=95)
    return path


@pytest.fixture(scope="module")
def taken_photo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return photo(tmp_path_factory.mktemp("taken") / "a.jpg")


def told(out: Path) -> dict[str, Any]:
    return json.loads((out / "estimate.json").read_text())


def estimated(path: Path, *options: str) -> dict[str, Any]:
    out = path.parent / "out"
    assert main(["estimate", str(path), "--light", "sh9", "--out", str(out), *options]) == 0
    return told(out)


def test_exif_data_tell_of_the_sun_and_results_not_of_the_place(taken_photo: Path) -> None:
    found = estimated(taken_photo)
    assert found["posterior"]["clock_wrong"] < 0.3
    assert found["advice"] == []
    private = (LATITUDE, LONGITUDE, right_heading_deg())
    for leaf in leaves(found):
        if isinstance(leaf, str):
            text = leaf.replace(str(taken_photo), "")
            assert not [word for word in PRIVATE if word in text], text
        elif isinstance(leaf, float):
            assert min(abs(leaf - one) for one in private) > 1e-4
    out = taken_photo.parent / "out"
    for name in ("probe.exr", "posterior.exr"):
        header = str(OpenEXR.File(str(out / name)).header())
        assert not [word for word in PRIVATE if word in header]
    assert b"2024" not in (out / "probe.hdr").read_bytes()[:200]
    with Image.open(out / "report.png") as report:
        assert not report.getexif()
        assert not [word for word in PRIVATE if word in str(report.info)]


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
    assert estimated(taken_photo, "--ignore-exif-sun")["posterior"]["clock_wrong"] is None


def test_they_are_kept_on_request(taken_photo: Path) -> None:
    kept = estimated(taken_photo, "--keep-place")["taken"]
    assert datetime.fromisoformat(kept["time"]) == MORNING
    assert kept["latitude_deg"] == pytest.approx(LATITUDE)
    assert kept["longitude_deg"] == pytest.approx(LONGITUDE)
    assert kept["heading_deg"] == pytest.approx(right_heading_deg(), abs=0.01)


@pytest.mark.slow
def test_what_is_said_by_hand_overrules(
    taken_photo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    opposite = str(round((right_heading_deg() + 180) % 360))
    found = estimated(taken_photo, "--heading", opposite)
    assert found["posterior"]["verdict"] == "doubtful: the face and the clock disagree"
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
    found = estimated(path)
    assert found["posterior"]["clock_wrong"] is None
    lines = [line for line in found["advice"] if "impossible and was ignored" in line]
    assert len(lines) == 3


def test_half_of_what_is_needed_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(sunny_face(30.0, 60.0).encoded).save(path)
    found = estimated(path, "--time", "2024-06-01T10:00Z")
    assert [line for line in found["advice"] if "without the picture's place" in line]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (("--time", "yesterday"), "is no time"),
        (("--time", "2024-06-01T10:00"), "no time zone"),
        (("--time", "2024-13-01T10:00Z"), "is no time"),
        (("--place", "Rome"), "is no place"),
        (("--place", "95,0"), "latitude 95"),
        (("--place", "41,12,3"), "is no place"),
        (("--heading", "720"), "heading 720"),
    ],
)
def test_bad_facts_by_hand_end_in_one_line(
    options: tuple[str, ...],
    what: str,
    taken_photo: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    assert main(["estimate", str(taken_photo), *options, "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert what in line
    assert not out.exists()


def test_a_folder_has_no_one_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--time", "2024-06-01T10:00Z"]
    assert main(["estimate", str(tmp_path), *options, "--out", str(tmp_path / "out")]) == 2
    assert "is a folder" in capsys.readouterr().err


@pytest.mark.slow
def test_each_photo_of_a_folder_has_its_own(taken_photo: Path, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(taken_photo.read_bytes())
    plain = Image.open(taken_photo)
    plain.save(tmp_path / "photos" / "b.png", exif=b"")
    settings = EstimateSettings(light="sh9", device="cpu")
    entries = estimate_folder(tmp_path / "photos", tmp_path / "out", settings)
    assert [entry.status for entry in entries] == ["done", "done"]
    assert told(tmp_path / "out" / "a_jpg")["posterior"]["clock_wrong"] is not None
    assert told(tmp_path / "out" / "b_png")["posterior"]["clock_wrong"] is None
    for name in ("manifest.jsonl", "settings.json"):
        text = (tmp_path / "out" / name).read_text()
        assert not [private for private in ("41.8", "12.49", "+02:00") if private in text]


def test_the_studio_tells_no_place(taken_photo: Path, tmp_path: Path) -> None:
    found = estimate_light(
        str(taken_photo), "a.jpg", 10**7, str(tmp_path), 1, "sh9", tell=lambda stage, share: None
    )
    assert found["posterior"]["clock_wrong"] is not None
    assert "taken" not in found
    assert found["advice"] == []


def test_from_python() -> None:
    codes = sunny_face(30.0, 60.0).encoded
    taken = Taken(
        time=MORNING,
        latitude_deg=LATITUDE,
        longitude_deg=LONGITUDE,
        heading_deg=right_heading_deg(),
    )
    found = skylight.estimate(photo_from_codes(codes), light="sh9", taken=taken)
    assert found.posterior.clock_wrong is not None
    assert found.posterior.clock_wrong < 0.3
