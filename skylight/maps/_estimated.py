"""What ``skylight estimate`` left in a folder, read back: its numbers, light, lamps and heads.

estimate.json may have been written by anybody, so nothing of it is used that is not checked.
"""

import math
from pathlib import Path
from typing import Any

import torch

from skylight._names import PLAIN_READING, Convention, MapReading
from skylight.errors import InputError
from skylight.inverse._result import Lamp
from skylight.io._bounded import json_content
from skylight.io._exr import white_luminance
from skylight.io._files import read_environment_map
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import direction_from_angles

NUMBERS, MAP = "estimate.json", "probe.exr"
LARGEST = 1e15  # beyond every number of an estimate, and products of several are finite
_IN_WORDS = {str: "text", bool: "true or false", int: "whole number", float: "number"}
# The disc of a lamp of 42 degrees is half of the sphere, the widest light that programs have.
SPREADS_DEG = 0.01, 42.0


def read_light(
    path: Path, convention: Convention, reading: MapReading = PLAIN_READING
) -> tuple[EnvironmentMap, tuple[Lamp, ...]]:
    """A map's light without lamps; that of an estimate's folder or estimate.json with its lamps.

    A sky alone gets a black lower half.
    """
    if not path.is_dir() and path.suffix.lower() != ".json":
        light = read_environment_map(path, convention=convention, **vars(reading))
        return whole_sphere(light), ()
    if convention != "skylight":
        raise InputError(
            f"{path}: an estimate's map is in skylight's convention, not {convention}'s: leave "
            "--from-convention out"
        )
    numbers, content = read_numbers(path)
    lamps = _lamps(numbers, content)
    return whole_sphere(read_environment_map(numbers.parent / MAP)), lamps


def read_numbers(path: Path) -> tuple[Path, dict[str, Any]]:
    """The estimate.json of a folder, or that file itself, and what it holds."""
    path = path / NUMBERS if path.is_dir() else path
    try:
        content = json_content(path)
    except FileNotFoundError as error:
        raise InputError(
            f"{path}: there is no such file; give a lat-long map, or a folder that skylight "
            "estimate wrote"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error})") from error
    if not isinstance(content, dict) or "light" not in content:
        raise InputError(f'{path}: these are not the numbers of an estimate: "light" is missing')
    return path, content


def luminance_of_1(path: Path) -> float | None:
    """cd/m^2 that a radiance of 1 stands for, None where unknown.

    Of an estimate as estimate.json has it, of an .exr as ``whiteLuminance`` in its header.
    """
    if not path.is_dir() and path.suffix.lower() != ".json":
        return white_luminance(path)
    numbers, content = read_numbers(path)
    try:
        told = picked(content.get("luminance"), ({"cd_per_m2": float}, None), "luminance")
        if told is not None and not told["cd_per_m2"] > 0:
            raise ValueError('"cd_per_m2" is not above 0')
    except ValueError as error:
        raise InputError(f"{numbers}: {error}: estimate the photograph again") from None
    return None if told is None else told["cd_per_m2"]


def head_file(numbers: Path, place: int, *, of: int) -> Path:
    """The mesh of one of so many faces of an estimate.json, at a place from 0 in its list."""
    path = numbers.parent / ("mesh.obj" if of == 1 else f"mesh_{place + 1}.obj")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; estimate the photograph again")
    return path


def whole_sphere(light: EnvironmentMap) -> EnvironmentMap:
    """The light, a sky alone with a black lower half."""
    return light.with_ground(torch.zeros(3)) if light.is_sky else light


def _lamps(path: Path, content: dict[str, Any]) -> tuple[Lamp, ...]:
    listed = content.get("lamps", [])
    if not isinstance(listed, list):
        raise InputError(f'{path}: "lamps" must be a list, got a {type(listed).__name__}')
    return tuple(_lamp(path, number, entry) for number, entry in enumerate(listed, start=1))


def _lamp(path: Path, number: int, entry: Any) -> Lamp:
    low, high = SPREADS_DEG
    try:
        azimuth, zenith, spread = (
            float(entry[name]) for name in ("azimuth_deg", "zenith_deg", "spread_deg")
        )
        red, green, blue = irradiance = [float(channel) for channel in entry["irradiance"]]
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError(
            f"{path}: lamp {number} needs azimuth_deg, zenith_deg, spread_deg and three numbers "
            "of irradiance"
        ) from None
    if not all(map(math.isfinite, (azimuth, zenith))) or not low <= spread <= high:
        raise InputError(
            f"{path}: lamp {number} needs finite angles and a spread of {low} to {high} degrees, "
            f"got azimuth {azimuth}, zenith {zenith}, spread {spread}"
        )
    if not all(0 <= channel < math.inf for channel in irradiance):
        raise InputError(
            f"{path}: lamp {number} needs a finite irradiance of 0 or more, got {irradiance}"
        )
    angles = torch.tensor([azimuth, zenith], dtype=torch.float64).deg2rad()
    return Lamp(
        direction=direction_from_angles(*angles),
        irradiance=torch.tensor([red, green, blue], dtype=torch.float64),
        spread_rad=math.radians(spread),
    )


def picked(value: Any, form: Any, name: str) -> Any:
    """The part of a JSON value that ``form`` describes, and nothing else of it.

    A form is a type, a list with the form of all elements or with the forms of so many, a dict
    with those of some keys (or of all of them, under ``str``), or a tuple of a form and None,
    where there may be null.
    """
    if isinstance(form, tuple):
        return None if value is None else picked(value, form[0], name)
    if isinstance(form, list):
        if not isinstance(value, list) or len(form) not in (1, len(value)):
            raise ValueError(f'"{name}" is no list' + (f" of {len(form)}" if len(form) > 1 else ""))
        forms = form if len(form) > 1 else form * len(value)
        return [picked(one, inner, name) for one, inner in zip(value, forms, strict=True)]
    if isinstance(form, dict):
        if not isinstance(value, dict):
            raise ValueError(f'"{name}" is no object')
        if str in form:
            return {key: picked(one, form[str], name) for key, one in value.items()}
        missing = [key for key in form if key not in value]
        if missing:
            raise ValueError(f'"{missing[0]}" is missing')
        return {key: picked(value[key], inner, key) for key, inner in form.items()}
    if type(value) in (int, float) and abs(value) > LARGEST:
        raise ValueError(f'"{name}" is too large')
    if form is float and type(value) in (int, float):
        return float(value)
    if form is float or type(value) is not form:
        raise ValueError(f'"{name}" is no {_IN_WORDS[form]}')
    return value
