"""The sun's position in the sky: NREL's solar position algorithm, to 0.0003 degrees.

I. Reda, A. Andreas, "Solar position algorithm for solar radiation applications", Solar Energy
76(5), 2004, and NREL/TP-560-34302. The Earth's place about the sun is a sum of periodic terms
(VSOP87, shortened); nutation and aberration give the apparent sun, sidereal time and parallax that
of an observer on the ellipsoid. Refraction is left out. The tables are in
``data/solar_terms.json`` (``tools/build_solar_terms.py``).
"""

import json
from functools import cache
from importlib.resources import files

import numpy as np
from jaxtyping import Float

# Terrestrial less universal time in seconds, of 2014; a second moves the sun by 1.1e-5 degrees
_DELTA_T_S = 67.0
_FLATTENING = 0.99664719  # of the Earth: polar over equatorial radius
_RADIUS_M = 6378140.0  # at the equator
# Polynomials in Julian ephemeris centuries, lowest power first, degrees: the moon's mean
# elongation, the sun's and the moon's mean anomalies, the moon's argument of latitude and node.
_MOON_AND_SUN = np.array(
    [
        [297.85036, 445267.111480, -0.0019142, 1 / 189474],
        [357.52772, 35999.050340, -0.0001603, -1 / 300000],
        [134.96298, 477198.867398, 0.0086972, 1 / 56250],
        [93.27191, 483202.017538, -0.0036825, 1 / 327270],
        [125.04452, -1934.136261, 0.0020708, 1 / 450000],
    ]
)
# Mean obliquity of the ecliptic in arcseconds, powers of Julian ephemeris millennia / 10
_OBLIQUITY = np.array(
    [84381.448, -4680.93, -1.55, 1999.25, -51.38, -249.67, -39.05, 7.12, 27.87, 5.79, 2.45]
)


@cache
def _terms() -> dict[str, list]:
    content = files("skylight.skies").joinpath("data", "solar_terms.json")
    return json.loads(content.read_text(encoding="utf-8"))


def sun_azimuth_zenith(
    unix_s: Float[np.ndarray, " t"],
    *,
    latitude_deg: float,
    longitude_deg: float,
    altitude_m: float,
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Azimuth (clockwise from north) and zenith angle in radians at times in seconds since 1970.

    The numbers of the steps are those of the report.
    """
    day = unix_s / 86400 + 2440587.5  # Julian day (3.1)
    century = (day - 2451545) / 36525
    ephemeris_century = (day + _DELTA_T_S / 86400 - 2451545) / 36525
    millennium = ephemeris_century / 10

    # 3.2, 3.3: the Earth about the sun, and the sun about the Earth
    radius_au = _periodic("radius", millennium)
    longitude = _periodic("longitude", millennium) + np.pi
    latitude = -_periodic("latitude", millennium)

    # 3.4 to 3.7: nutation, obliquity and aberration
    nutation, obliquity_nutation = _nutation(ephemeris_century)
    arcseconds = np.polynomial.polynomial.polyval(millennium / 10, _OBLIQUITY)
    obliquity = np.radians(arcseconds / 3600) + obliquity_nutation
    longitude = longitude + nutation - np.radians(20.4898 / 3600 / radius_au)

    # 3.8 to 3.11: sidereal time, right ascension, declination, hour angle
    sidereal_deg = (
        280.46061837
        + 360.98564736629 * (day - 2451545)
        + 0.000387933 * century**2
        - century**3 / 38710000
    ) % 360
    sidereal = np.radians(sidereal_deg) + nutation * np.cos(obliquity)
    ascension = np.arctan2(
        np.sin(longitude) * np.cos(obliquity) - np.tan(latitude) * np.sin(obliquity),
        np.cos(longitude),
    )
    declination = np.arcsin(
        np.sin(latitude) * np.cos(obliquity)
        + np.cos(latitude) * np.sin(obliquity) * np.sin(longitude)
    )
    hour = sidereal + np.radians(longitude_deg) - ascension

    # 3.12, 3.13: parallax, as seen from the ellipsoid
    north = np.radians(latitude_deg)
    reduced = np.arctan(_FLATTENING * np.tan(north))
    x = np.cos(reduced) + altitude_m / _RADIUS_M * np.cos(north)
    y = _FLATTENING * np.sin(reduced) + altitude_m / _RADIUS_M * np.sin(north)
    parallax = np.sin(np.radians(8.794 / 3600 / radius_au))
    across = np.cos(declination) - x * parallax * np.cos(hour)
    shift = np.arctan2(-x * parallax * np.sin(hour), across)
    declination = np.arctan2((np.sin(declination) - y * parallax) * np.cos(shift), across)
    hour = hour - shift

    # 3.14, 3.15: zenith and azimuth
    height = np.arcsin(
        np.sin(north) * np.sin(declination) + np.cos(north) * np.cos(declination) * np.cos(hour)
    )
    from_south = np.arctan2(
        np.sin(hour), np.cos(hour) * np.sin(north) - np.tan(declination) * np.cos(north)
    )
    return (from_south + np.pi) % (2 * np.pi), np.pi / 2 - height


def _periodic(name: str, millennium: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
    """``sum_k t^k sum_i A cos(B + C t) / 1e8``, with a table of rows A, B, C for each power k."""
    total = np.zeros_like(millennium)
    for power, table in enumerate(_terms()[name]):
        size, phase, rate = np.array(table).T[:, :, None]
        total += (size * np.cos(phase + rate * millennium)).sum(0) * millennium**power
    return total / 1e8


def _nutation(
    century: Float[np.ndarray, " t"],
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """In longitude and in obliquity, radians (3.4)."""
    moon_and_sun = np.polynomial.polynomial.polyval(century, _MOON_AND_SUN.T)  # (5, t)
    angle = np.radians(np.array(_terms()["nutation_arguments"]) @ moon_and_sun)  # (63, t)
    a, b, c, d = np.array(_terms()["nutation"]).T[:, :, None]
    longitude = ((a + b * century) * np.sin(angle)).sum(0)
    obliquity = ((c + d * century) * np.cos(angle)).sum(0)
    return np.radians(longitude / 36_000_000), np.radians(obliquity / 36_000_000)
