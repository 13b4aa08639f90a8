"""Time, place and heading of a photograph as they are given on the command line."""

from datetime import datetime

from skylight.errors import InputError
from skylight.imaging.taken import Taken


def taken_by_hand(time: str | None, place: str | None, heading: float | None) -> Taken | None:
    """None where nothing was given.

    Raises
    ------
    InputError
        No time with a zone, no place, or none on Earth, no heading from 0 to 360 degrees.
    """
    if time is None and place is None and heading is None:
        return None
    latitude_deg, longitude_deg = (None, None) if place is None else _place(place)
    return Taken(
        time=None if time is None else _time(time),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_deg=heading,
    )


def _time(text: str) -> datetime:
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(
            f"--time {text!r} is no time; write it as 2024-06-01T14:30+02:00"
        ) from error
    if time.tzinfo is None:
        raise InputError(f"--time {text!r} has no time zone; end it with one, as +02:00, or Z")
    return time


def _place(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = text.split(",")
        return float(latitude), float(longitude)
    except ValueError as error:
        raise InputError(
            f"--place {text!r} is no place; give degrees north and east as 41.89,12.49"
        ) from error
