"""Where and when a photograph was taken, and where its camera looked."""

from dataclasses import dataclass, replace
from datetime import datetime

from skylight.errors import InputError

YEARS = (1900, 2100)
HEADING_ERROR_DEG = 10.0  # of a heading read from a map or a compass by hand


@dataclass(frozen=True, kw_only=True)
class CaptureMetadata:
    """Facts about a picture that do not depend on its pixels; None where they are unknown.

    ``time`` has a time zone, or is that of the clocks there, in an unknown zone (no ``tzinfo``).
    ``latitude_deg`` counts north and ``longitude_deg`` east, both or neither. ``heading_deg`` is
    where the level camera looks (its -Z), clockwise from true north, ``heading_error_deg`` the
    standard deviation of that. ``notes``: what was recorded and cannot be, a line each.

    Raises
    ------
    InputError
        A year before 1900 or after 2100, a place that is none on Earth, a heading that is not
        from 0 to 360 degrees.
    """

    time: datetime | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    heading_deg: float | None = None
    heading_error_deg: float = HEADING_ERROR_DEG
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.time is not None and not YEARS[0] <= self.time.year <= YEARS[1]:
            raise InputError(
                f"the year {self.time.year} is not from {YEARS[0]} to {YEARS[1]}; check the time"
            )
        if (self.latitude_deg is None) != (self.longitude_deg is None):
            raise InputError("a place is a latitude and a longitude; give both")
        # written so that NaN is refused too
        if self.latitude_deg is not None and not -90 <= self.latitude_deg <= 90:
            raise InputError(f"latitude {self.latitude_deg:g} is not from -90 to 90 degrees north")
        if self.longitude_deg is not None and not -180 <= self.longitude_deg <= 180:
            raise InputError(
                f"longitude {self.longitude_deg:g} is not from -180 to 180 degrees east"
            )
        if self.heading_deg is not None and not 0 <= self.heading_deg <= 360:
            raise InputError(
                f"heading {self.heading_deg:g} is not from 0 to 360 degrees clockwise from north"
            )
        if not 0 < self.heading_error_deg <= 180:
            raise InputError(
                f"a heading's error of {self.heading_error_deg:g} degrees is not above 0 up to 180"
            )

    @property
    def is_nothing(self) -> bool:
        """Nothing is known, not even of something that cannot be."""
        return (self.time, self.latitude_deg, self.heading_deg) == (None,) * 3 and not self.notes

    def overruled_by(self, other: "CaptureMetadata") -> "CaptureMetadata":
        """``other``, and this where it knows nothing; place and heading go with what is theirs."""
        known = replace(self, notes=(*self.notes, *other.notes))
        if other.time is not None:
            known = replace(known, time=other.time)
        if other.latitude_deg is not None:
            known = replace(
                known, latitude_deg=other.latitude_deg, longitude_deg=other.longitude_deg
            )
        if other.heading_deg is not None:
            known = replace(
                known,
                heading_deg=other.heading_deg,
                heading_error_deg=other.heading_error_deg,
            )
        return known
