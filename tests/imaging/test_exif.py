"""Where, when and whether with a flash: photographs with EXIF data that Pillow writes."""

import math
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image

from skylight.errors import InputError
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.imaging._exposure import UNCERTAINTY_STOPS, CameraExposure
from skylight.imaging._photo import Photo, read_photo

CLOCK = {"DateTimeOriginal": "2024:06:01 14:30:00"}
ZONE = {"OffsetTimeOriginal": "+02:00"}
ROME = {
    "GPSLatitudeRef": "N",
    "GPSLatitude": (41.0, 53.0, 24.0),
    "GPSLongitudeRef": "E",
    "GPSLongitude": (12.0, 29.0, 24.0),
}
SATELLITES = {"GPSDateStamp": "2024:06:01", "GPSTimeStamp": (12.0, 29.0, 58.5)}


def photo(folder: Path, **tags: Any) -> Photo:
    """A JPEG with these tags, read."""
    data = Image.Exif()
    inner, gps = data.get_ifd(ExifTags.IFD.Exif), data.get_ifd(ExifTags.IFD.GPSInfo)
    for name, value in tags.items():
        if name.startswith("GPS"):
            gps[ExifTags.GPS[name]] = value
        else:
            inner[ExifTags.Base[name]] = value
    codes = np.random.default_rng(0).integers(0, 256, (32, 40, 3), dtype=np.uint8)
    Image.fromarray(codes).save(folder / "a.jpg", exif=data)
    return read_photo(folder / "a.jpg")


def taken(folder: Path, **tags: Any) -> CaptureMetadata:
    found = photo(folder, **tags).taken
    assert found is not None
    return found


def test_a_camera_that_tells_nothing(tmp_path: Path) -> None:
    plain = photo(tmp_path)
    assert (plain.taken, plain.flash) == (None, None)


@pytest.mark.parametrize(
    ("seconds", "aperture", "sensitivity", "value"),
    [
        (1 / 128, 16.0, 100, 15.0),
        (1 / 30, 2.0, 800, 3.91),
        (0.0, 2.0, 100, None),
        (1.0, 0.0, 100, None),
        (1e9, 2.0, 100, None),
        (1 / 100, 2.0, 65535, None),
        (1 / 64, 4.0, (200, 200), 9.0),
    ],
)
def test_how_bright_the_scene_was(
    tmp_path: Path, seconds: float, aperture: float, sensitivity: Any, value: float | None
) -> None:
    """Sunny 16: in the sun f/16 and the reciprocal of the sensitivity; a living room at night."""
    tags = {"ExposureTime": seconds, "FNumber": aperture, "ISOSpeedRatings": sensitivity}
    found = photo(tmp_path, **tags).exposure_value
    assert found == (value if value is None else pytest.approx(value, abs=0.01))
    del tags["ISOSpeedRatings"]
    assert photo(tmp_path, **tags).exposure_value is None


def test_a_pixel_value_stands_for_a_luminance(tmp_path: Path) -> None:
    """ISO 2720's law by numbers, and physics: the sun at noon gives about 100,000 lux.

    Exposed by sunny 16, a white diffuse surface in it, 100,000 / pi cd/m^2, then is near white.
    """
    found = photo(tmp_path, ExposureTime=1 / 50, FNumber=2.8, ISOSpeedRatings=400)
    assert found.camera_exposure is not None
    metered = 12.5 * 2.8**2 * 50 / 400  # what a meter with K = 12.5 calls for these settings
    assert 0.18 * found.camera_exposure.cd_per_m2 == pytest.approx(metered)
    sunny = CameraExposure(seconds=1 / 100, aperture=16.0, iso=100.0)
    white = 100_000 / math.pi / sunny.cd_per_m2
    assert abs(math.log2(white)) < UNCERTAINTY_STOPS
    # twice the time shows half the luminance at a value; a stop of aperture does too
    longer = CameraExposure(seconds=1 / 50, aperture=16.0, iso=100.0)
    wider = CameraExposure(seconds=1 / 100, aperture=16 / math.sqrt(2), iso=100.0)
    assert longer.cd_per_m2 == pytest.approx(sunny.cd_per_m2 / 2)
    assert wider.cd_per_m2 == pytest.approx(sunny.cd_per_m2 / 2)


def test_clock_with_its_zone(tmp_path: Path) -> None:
    found = taken(tmp_path, **CLOCK, **ZONE)
    assert found.time == datetime(2024, 6, 1, 12, 30, tzinfo=UTC)
    assert found.time.utcoffset() == timedelta(hours=2)
    west = taken(tmp_path, **CLOCK, OffsetTimeOriginal="-03:30").time
    assert west == datetime(2024, 6, 1, 18, tzinfo=UTC)
    assert taken(tmp_path, **CLOCK, OffsetTimeOriginal="Z").time == west.replace(
        hour=14, minute=30, tzinfo=UTC
    )


@pytest.mark.parametrize("zone", ["", "   :  "])
def test_clock_without_a_zone(tmp_path: Path, zone: str) -> None:
    found = taken(tmp_path, **CLOCK, OffsetTimeOriginal=zone)
    assert found.time == datetime(2024, 6, 1, 14, 30)
    assert found.time.tzinfo is None
    assert found.notes == ()


def test_satellites_tell_universal_time(tmp_path: Path) -> None:
    found = taken(tmp_path, **CLOCK, **SATELLITES)
    assert found.time == datetime(2024, 6, 1, 12, 29, 58, 500_000, tzinfo=UTC)


def test_place_in_degrees_minutes_and_seconds(tmp_path: Path) -> None:
    found = taken(tmp_path, **ROME)
    assert found.latitude_deg == pytest.approx(41.89)
    assert found.longitude_deg == pytest.approx(12.49)
    south = taken(tmp_path, **ROME | {"GPSLatitudeRef": "S", "GPSLongitudeRef": "W"})
    assert south.latitude_deg == pytest.approx(-41.89)
    assert south.longitude_deg == pytest.approx(-12.49)
    half = {name: value for name, value in ROME.items() if "Latitude" in name}
    assert photo(tmp_path, **half).taken is None


def test_a_compass_that_shows_magnetic_north_is_less_exact(tmp_path: Path) -> None:
    true = taken(tmp_path, GPSImgDirectionRef="T", GPSImgDirection=271.5)
    magnetic = taken(tmp_path, GPSImgDirectionRef="M", GPSImgDirection=271.5)
    unsaid = taken(tmp_path, GPSImgDirection=271.5)
    assert true.heading_deg == magnetic.heading_deg == pytest.approx(271.5)
    assert true.heading_error_deg < magnetic.heading_error_deg == unsaid.heading_error_deg


@pytest.mark.parametrize(
    ("tags", "what"),
    [
        ({"DateTimeOriginal": "2024:13:01 10:00:00"}, "the time in"),
        ({"DateTimeOriginal": "0000:00:00 00:00:00"}, "the time in"),
        ({"DateTimeOriginal": "2024:06:01 25:00:00"}, "the time in"),
        ({"DateTimeOriginal": "0024:06:01 10:00:00"}, "the time in"),
        ({"DateTimeOriginal": "yesterday"}, "the time in"),
        (CLOCK | {"OffsetTimeOriginal": "+25:00"}, "the time zone"),
        (CLOCK | {"OffsetTimeOriginal": "CEST"}, "the time zone"),
        (SATELLITES | {"GPSTimeStamp": (24.0, 0.0, 0.0)}, "the satellites' time"),
        (SATELLITES | {"GPSDateStamp": "2024:02:30"}, "the satellites' time"),
        (SATELLITES | {"GPSDateStamp": "0000:00:00"}, "the satellites' time"),
        (ROME | {"GPSLatitude": (95.0, 0.0, 0.0)}, "the place in"),
        (ROME | {"GPSLongitude": (200.0, 0.0, 0.0)}, "the place in"),
        (ROME | {"GPSLatitude": (0.0,) * 3, "GPSLongitude": (0.0,) * 3}, "the place 0, 0"),
        ({"GPSImgDirection": 720.0}, "the heading"),
    ],
)
def test_what_cannot_be_is_left_out_with_a_line(tmp_path: Path, tags: dict, what: str) -> None:
    found = taken(tmp_path, **tags)
    (note,) = found.notes
    assert note.startswith(what)
    assert note.endswith("ignored")
    for value in tags.values():  # places and times are private
        assert len(str(value)) < 3 or str(value) not in note
    if what != "the time zone":
        assert (found.time, found.latitude_deg, found.heading_deg) == (None, None, None)
    else:
        assert found.time == datetime(2024, 6, 1, 14, 30)


def test_a_bad_satellite_time_leaves_the_clocks(tmp_path: Path) -> None:
    found = taken(tmp_path, **CLOCK, **ZONE, GPSDateStamp="2024:06:01", GPSTimeStamp=(99.0, 0, 0))
    assert found.time == datetime(2024, 6, 1, 12, 30, tzinfo=UTC)


def test_blanks_are_an_unknown_time(tmp_path: Path) -> None:
    assert photo(tmp_path, DateTimeOriginal="    :  :     :  :  ").taken is None


@pytest.mark.parametrize(("code", "fired"), [(0x1, True), (0x19, True), (0x10, False), (0, False)])
def test_the_flash(tmp_path: Path, code: int, fired: bool) -> None:
    assert photo(tmp_path, Flash=code).flash is fired


@pytest.mark.parametrize(
    ("facts", "what"),
    [
        ({"latitude_deg": 95.0, "longitude_deg": 0.0}, "latitude 95"),
        ({"latitude_deg": float("nan"), "longitude_deg": 0.0}, "latitude nan"),
        ({"latitude_deg": 0.0, "longitude_deg": 181.0}, "longitude 181"),
        ({"latitude_deg": 5.0}, "give both"),
        ({"heading_deg": 720.0}, "heading 720"),
        ({"heading_deg": -1.0}, "heading -1"),
        ({"heading_deg": 1.0, "heading_error_deg": 0.0}, "error of 0"),
        ({"time": datetime(1200, 1, 1)}, "year 1200"),
    ],
)
def test_facts_by_hand_are_checked(facts: dict, what: str) -> None:
    with pytest.raises(InputError, match=what) as error:
        CaptureMetadata(**facts)
    assert "\n" not in str(error.value)


def test_what_is_said_by_hand_overrules() -> None:
    zone = timezone(timedelta(hours=2))
    recorded = CaptureMetadata(
        time=datetime(2024, 6, 1),
        latitude_deg=1.0,
        longitude_deg=2.0,
        heading_deg=3.0,
        heading_error_deg=20.0,
        notes=("a note",),
    )
    hand = CaptureMetadata(
        time=datetime(2023, 1, 1, tzinfo=zone), latitude_deg=8.0, longitude_deg=9.0
    )
    both = recorded.overruled_by(hand)
    assert both == CaptureMetadata(
        time=hand.time,
        latitude_deg=8.0,
        longitude_deg=9.0,
        heading_deg=3.0,
        heading_error_deg=20.0,
        notes=("a note",),
    )
    turned = recorded.overruled_by(CaptureMetadata(heading_deg=90.0))
    assert (turned.heading_deg, turned.heading_error_deg) == (90.0, 10.0)
    assert turned.time == recorded.time
