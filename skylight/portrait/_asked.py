"""Lights as they are asked for, before an estimate is there, and the pictures of a face in them."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from skylight._names import PLAIN_READING, KeyName, MapReading
from skylight.errors import InputError
from skylight.estimation._kept import FoundLight, KeptFace
from skylight.estimation._manifest import file_hash
from skylight.estimation._summary import PhotoEstimate
from skylight.portrait._files import RelitPortrait, relit_portrait, taken_apart, write_relit
from skylight.portrait._keys import KEY_OVER_FILL, KEYS, USUAL_DEG, check_key, key_light
from skylight.portrait._lights import NewLight, light_of_map, light_with_sun_at, rotated_light
from skylight.portrait._relit import Keep
from skylight.work._progress import Progress
from skylight.work._threads import cores


@dataclass(frozen=True, kw_only=True)
class AskedLight:
    """What ``make`` makes of the light found; ``name`` ends the names of pictures in it.

    ``facts`` are all that it depends on beside that light.
    """

    name: str
    make: Callable[[FoundLight], NewLight]
    facts: Mapping[str, object]
    keep: Keep = "place"


def angles_of(text: str, option: str) -> tuple[float, float]:
    """(azimuth, elevation) in degrees of AZ,EL."""
    try:
        azimuth, elevation = (float(part) for part in text.split(","))
    except ValueError:
        azimuth = elevation = math.nan
    if not (math.isfinite(azimuth) and math.isfinite(elevation)):
        raise InputError(
            f"{option} wants AZ,EL in degrees, such as 40,35 ({option}=-40,35), got {text!r}"
        )
    return azimuth, elevation


def asked_keys(
    keys: Sequence[KeyName],
    angles: Sequence[tuple[float, float]],
    size_deg: float | None = None,
    strength: float | None = None,
) -> list[AskedLight]:
    """Key lights, each once; None is what is usual."""
    size_deg = USUAL_DEG if size_deg is None else size_deg
    strength = KEY_OVER_FILL if strength is None else strength
    named = {key: KEYS[key] for key in keys}
    named |= {f"{azimuth:g}_{elevation:g}": (azimuth, elevation) for azimuth, elevation in angles}
    for place in named.values():
        check_key(*place, size_deg, strength)
    return [
        AskedLight(
            name=name,
            make=partial(key_light, key=place, size_deg=size_deg, strength=strength),
            facts={"key": place, "size_deg": size_deg, "strength": strength},
        )
        for name, place in named.items()
    ]


def asked_turn(turn_deg: float) -> AskedLight:
    """The light found, turned."""
    if not math.isfinite(turn_deg):
        raise InputError(f"--turn wants degrees, got {turn_deg}")
    make = partial(rotated_light, turn_deg=turn_deg)
    return AskedLight(name="relit", make=make, facts={"turn_deg": turn_deg})


def asked_sun(place: tuple[float, float], strength: float | None) -> AskedLight:
    """The light found with its sun moved."""
    azimuth_deg, elevation_deg = place
    return AskedLight(
        name="relit",
        make=partial(
            light_with_sun_at,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            strength=strength,
        ),
        facts={"sun": place, "strength": strength},
    )


def asked_map(path: Path, reading: MapReading = PLAIN_READING) -> AskedLight:
    """The light of a map, which leaves the face as bright as it was."""
    return AskedLight(
        name="relit",
        make=_Given(light=light_of_map(path, reading)),
        facts={"under": file_hash(path), "reading": vars(reading)},
        keep="brightness",
    )


@dataclass(frozen=True, kw_only=True)
class _Given:
    """A light that does not depend on the one found."""

    light: NewLight

    def __call__(self, found: FoundLight) -> NewLight:
        return self.light


def written_pictures(
    result: PhotoEstimate | KeptFace,
    pictures: Mapping[Path, AskedLight],
    *,
    exposure: float = 1.0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Iterator[RelitPortrait]:
    """The (first) face of an estimate in each of the lights, once that is written.

    The photograph is taken apart once; ``exposure`` and ``workers`` are those of
    :func:`~skylight.portrait._files.relit_portrait`.
    """
    face, tell = KeptFace.of(result), progress or (lambda _share: None)
    part = 1 / (1 + len(pictures))  # of all work, roughly
    portrait = taken_apart(
        face, workers=workers or cores(), progress=lambda share: tell(part * share)
    )
    for number, (path, light) in enumerate(pictures.items(), start=2):
        relit = relit_portrait(
            face, light.make(face), exposure=exposure, keep=light.keep, portrait=portrait
        )
        write_relit(path, relit)
        tell(part * number)
        yield relit
