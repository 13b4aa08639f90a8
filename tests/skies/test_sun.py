import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pvlib
import pytest

from skylight.skies._sun import SUN_RADIUS_RAD, Place, sun_angles
from tools.check_skies import sun_positions

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "sun_position.json").read_text())


@pytest.mark.parametrize("case", GOLDEN, ids=lambda case: case["time"])
def test_published_positions(case: dict) -> None:
    place = Place(
        latitude_deg=case["latitude_deg"],
        longitude_deg=case["longitude_deg"],
        altitude_m=case["altitude_m"],
    )
    azimuth, zenith = np.degrees(sun_angles(place, [datetime.fromisoformat(case["time"])]))
    assert azimuth[0] == pytest.approx(case["azimuth_deg"], abs=case["tolerance_deg"])
    elevation = 90 - zenith[0]
    assert elevation == pytest.approx(case["true_elevation_deg"], abs=case["tolerance_deg"])


@pytest.mark.parametrize("latitude_deg", [-89.0, -33.0, 0.0, 51.5])
def test_another_implementation(latitude_deg: float) -> None:
    """pvlib's, of the same algorithm: the same but for rounding, in any year of 1970 to 2050."""
    place = Place(latitude_deg=latitude_deg, longitude_deg=-77.2, altitude_m=1830.0)
    times = [datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=70.37 * n) for n in range(400)]
    expected = pvlib.solarposition.get_solarposition(
        pd.DatetimeIndex(times), latitude_deg, place.longitude_deg, altitude=place.altitude_m
    )
    azimuth, zenith = np.degrees(sun_angles(place, times))
    np.testing.assert_allclose(zenith, expected["zenith"], rtol=0, atol=1e-9)
    apart = (azimuth - expected["azimuth"].to_numpy() + 180) % 360 - 180
    np.testing.assert_allclose(apart, 0, atol=1e-9)


def test_zenith_is_without_refraction() -> None:
    """Air lifts the sun by about 0.0167 degrees at this height; ours is the true place."""
    case = GOLDEN[0]
    place = Place(latitude_deg=case["latitude_deg"], longitude_deg=case["longitude_deg"])
    zenith = math.degrees(sun_angles(place, [datetime.fromisoformat(case["time"])])[1][0])
    assert zenith - case["refracted_zenith_deg"] == pytest.approx(0.0167, abs=0.002)


def test_naval_observatory(shared_data: Path) -> None:
    """All 6259 positions by the US Naval Observatory, geometric, all over the Earth.

    Within 2e-4 degrees, the last digits of their tables; the algorithm claims 3e-4.
    """
    path = shared_data / "reference" / "usno_sun_positions_6259.txt"
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the collected data")
    found = sun_positions(shared_data)
    assert found["rows"] == 6259
    assert found["sun_angles_off"] < 1e-9
    assert found["zenith_max"] < 2e-4
    assert found["azimuth_max"] < 2e-4
    assert found["zenith_mean"] < 5e-5
    assert found["azimuth_mean"] < 5e-5


def test_time_zone_is_required() -> None:
    with pytest.raises(ValueError, match="time zone"):
        sun_angles(Place(latitude_deg=0.0, longitude_deg=0.0), [datetime(2020, 1, 1)])


def test_disc_solid_angle() -> None:
    """6.807e-5 sr, the disc of the Prague sky model."""
    assert 2 * math.pi * (1 - math.cos(SUN_RADIUS_RAD)) == pytest.approx(6.807e-5, rel=1e-4)
