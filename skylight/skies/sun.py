"""The position of the sun for a place and a time."""

from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta

import numpy as np
from numpy.typing import NDArray

# Mean angular radius of the solar disc; its solid angle is 6.807e-5 sr.
SUN_RADIUS_RAD = np.radians(0.2667)


@dataclass(frozen=True, kw_only=True)
class Place:
    """Geographic position: degrees north and east, metres above the sea."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0


def sun_midnight(place: Place, day: date) -> datetime:
    """When a day begins by the place's mean sun time, in UTC: 4 minutes earlier a degree east."""
    return datetime.combine(day, time(), UTC) - timedelta(hours=place.longitude_deg / 15)


def sun_angles(place: Place, times: list[datetime]) -> tuple[NDArray, NDArray]:
    """True (refraction-free) sun azimuth (clockwise from north) and zenith angle, radians.

    pvlib's implementation of NREL's solar position algorithm (Reda & Andreas 2004), good to
    0.0003 degrees. ``times`` must carry a time zone.
    """
    import pandas as pd
    import pvlib

    if any(moment.tzinfo is None for moment in times):
        raise ValueError("sun_angles needs times with a time zone, e.g. datetime(..., tzinfo=UTC)")
    table = pvlib.solarposition.get_solarposition(
        pd.DatetimeIndex(times),
        place.latitude_deg,
        place.longitude_deg,
        altitude=place.altitude_m,
    )
    return (
        np.radians(np.asarray(table["azimuth"], dtype=float)),
        np.radians(np.asarray(table["zenith"], dtype=float)),
    )
