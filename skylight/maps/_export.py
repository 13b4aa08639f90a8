"""Environment maps exported for other programs.

The map and the lamps of an estimate's results, or a map alone.

An estimate of a portrait as a scene of Blender.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.faces._observe import SKIN_GLOSS
from skylight.imaging._colour import tone_map
from skylight.imaging._photo import read_photo
from skylight.inverse._result import Lamp
from skylight.io._bounded import json_content
from skylight.io._files import read_environment_map
from skylight.io._hdr import RGBE_MAX
from skylight.maps._names import LightTarget
from skylight.relight._blender import PortraitScene, write_blender, write_blender_scene
from skylight.relight._gltf import write_gltf, write_threejs
from skylight.relight._lamps import LAST_SIZE, split_main_light, without_lamps
from skylight.relight._mitsuba import write_harmonics, write_mitsuba
from skylight.relight._usd import write_augmented_reality, write_usd
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import direction_from_angles
from skylight.sphere._names import Convention, HarmonicConvention
from skylight.work._resumable import results_folder

NUMBERS, MAP = "estimate.json", "probe.exr"
# The disc of a lamp of 42 degrees is half of the sphere, the widest light that programs have.
SPREADS_DEG = 0.01, 42.0


def read_light(path: Path, convention: Convention) -> tuple[EnvironmentMap, tuple[Lamp, ...]]:
    """A map's light without lamps; that of an estimate's folder or estimate.json with its lamps.

    A sky alone gets a black lower half.

    Raises
    ------
    InputError
        A file is missing or damaged, or a map of an estimate is said to have another convention.
    """
    if not path.is_dir() and path.suffix.lower() != ".json":
        return whole_sphere(read_environment_map(path, convention=convention)), ()
    if convention != "skylight":
        raise InputError(
            f"{path}: an estimate's map is in skylight's convention, not {convention}'s: leave "
            "--from-convention out"
        )
    numbers, content = read_numbers(path)
    lamps = _lamps(numbers, content)
    return whole_sphere(read_environment_map(numbers.parent / MAP)), lamps


def read_numbers(path: Path) -> tuple[Path, dict[str, Any]]:
    """The estimate.json of a folder, or that file itself, and what it holds.

    Raises
    ------
    InputError
        The file is missing or damaged, or is that of something else.
    """
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


def head_file(numbers: Path, place: int, *, of: int) -> Path:
    """The mesh of one of so many faces of an estimate.json, at a place from 0 in its list.

    Raises
    ------
    InputError
        It is not there.
    """
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


WHOLE = {"sh", "ar"}  # targets that have no lights of an artist's own to move
LARGEST_FACE = 2048


@dataclass(frozen=True, kw_only=True)
class ExportedLight:
    """What was written: ``cut`` is the share of the light that light.glb's reflections lack.

    ``lamps`` is how many became lights of their own.
    """

    files: list[str]
    lamps: int
    cut: float


def export_light(
    probe: Path,
    out: Path,
    targets: Sequence[LightTarget],
    *,
    convention: Convention = "skylight",
    harmonics: HarmonicConvention = "skylight",
    face: int | None = None,
) -> ExportedLight:
    """Write the files of each target into the folder ``out``.

    ``probe`` is a map, or an estimate's folder or estimate.json: its lamps are lights of their own
    of all targets but "sh" and "ar", beside the rest of its map.

    ``face`` is the side of a cube map's faces, a power of two from 32; by default the largest that
    shows no more detail than the map's horizon, from 64 to 512. A sky alone gets a black lower
    half.

    Raises
    ------
    InputError
        A map or estimate that cannot be read, no target, or a face size that cannot be.
    """
    if not targets:
        raise InputError("name at least one target with --as")
    if face is not None and (face & (face - 1) or not 2 * LAST_SIZE <= face <= LARGEST_FACE):
        raise InputError(
            f"a cube map's faces are a power of two from {2 * LAST_SIZE} to {LARGEST_FACE} pixels "
            f"wide, not {face}"
        )
    light, lamps = read_light(probe, convention)
    separate = lamps if set(targets) - WHOLE else ()
    rest = without_lamps(light, separate)
    size = face or default_face(light)
    written: list[str] = []
    cut = 0.0
    with results_folder(out) as folder:
        for target in dict.fromkeys(targets):
            if target == "threejs":
                written += write_threejs(folder, rest, lamps)
            elif target == "sh":
                written += write_harmonics(folder, light, harmonics)
            elif target == "ar":
                written += write_augmented_reality(folder, light, size)
            elif target == "gltf":
                files, cut = write_gltf(folder, rest, size, lamps)
                written += files
            elif target == "usd":
                written += write_usd(folder, rest, lamps)
            elif target == "mitsuba":
                written += write_mitsuba(folder, rest, lamps)
            else:
                written += write_blender(folder, rest, lamps)
    return ExportedLight(files=written, lamps=len(separate), cut=cut)


def default_face(light: EnvironmentMap) -> int:
    """A quarter of the horizon's pixels, rounded up to a power of two between 64 and 512."""
    quarter = light.layout[1] // 4
    return min(512, max(64, 1 << (quarter - 1).bit_length()))


MOST_REFLECTED = 0.99  # at normal incidence: no index of refraction reflects all
_LARGEST = 1e6  # of albedos and white balances, of sides and focal lengths in pixels


def export_blender_scene(estimate: Path, out: Path, *, photo: Path | None = None) -> list[str]:
    """Write what the extension of Blender sets up, and return the files' names.

    The sun, or an estimate's lamps, are lights of their own and the map is the rest. All light is
    multiplied by the picture's white balance, so that a surface of albedo a shows a / pi times its
    irradiance in the photograph's own linear values. Of several faces, the first one counts, with
    its photograph.

    Parameters
    ----------
    estimate
        The folder that ``skylight estimate`` wrote for a photograph, or its estimate.json.
    photo
        The photograph, where it is not any more where estimate.json says. A relative path there
        is one from the current folder or from that which the estimate's folder is in, as
        ``skylight estimate portrait.jpg`` leaves it.

    Raises
    ------
    InputError
        The estimate or the photograph is missing or damaged, or they do not belong together.
    """
    numbers, content = read_numbers(estimate)
    told = _Numbers(numbers, content)
    picture = photo or _where_it_was(told.source, numbers)
    if not os.path.isfile(picture):  # Path's raises for names that cannot be
        raise InputError(f"{picture}: the photograph is not there; say where it is with --photo")
    codes = _codes(picture)
    height, width = codes.shape[:2]
    if [width, height] != told.picture_px:
        raise InputError(
            f"{picture}: {width} x {height} pixels, and the estimate is of a photograph of "
            f"{told.picture_px[0]} x {told.picture_px[1]}; give that with --photo"
        )
    light, lamps = read_light(numbers, "skylight")
    brightest = max([light.radiance.max(), *(lamp.irradiance.max() for lamp in lamps)])
    if brightest > RGBE_MAX / _LARGEST:  # so that it is finite times the white balance
        raise InputError(f"{numbers}: radiance of {brightest:.3g} is no light; estimate again")
    ambient, named = _named_lights(light, lamps)
    head = head_file(numbers, 0, of=told.faces)
    shown = told.white_balance
    scene = PortraitScene(
        ambient=EnvironmentMap(radiance=ambient.radiance * shown.to(ambient.radiance)),
        lamps=[(name, replace(each, irradiance=each.irradiance * shown)) for name, each in named],
        photograph=codes,
        focal_px=told.focal_px,
        head=head,
        albedo=told.albedo,
        specular=replace(SKIN_GLOSS, f0=min(told.gloss * SKIN_GLOSS.f0, MOST_REFLECTED)),
        verdict=told.verdict,
        advice=told.advice,
    )
    with results_folder(out) as folder:
        return write_blender_scene(folder, scene)


def _where_it_was(source: Path, numbers: Path) -> Path:
    beside = numbers.resolve().parent.parent / source  # as it is where it is absolute
    return beside if os.path.isfile(beside) and not os.path.isfile(source) else source


class _Numbers:
    """What of estimate.json is needed."""

    def __init__(self, path: Path, content: dict[str, Any]) -> None:
        try:
            face = content["faces"][0]
            self.faces = len(content["faces"])
            self.source = Path(face["source"])
            self.picture_px = [int(side) for side in face["picture_px"]]
            self.focal_px = float(face["focal_length_px"])
            self.albedo = _three(face["albedo"])
            self.gloss = float(face["gloss"])
            self.white_balance = _three(content["white_balance"])
            self.verdict = str(content["posterior"]["verdict"])
            self.advice = [str(line) for line in content["advice"]]
            whole = len(self.picture_px) == 2 and max(self.picture_px) < _LARGEST
            whole = whole and 0 < self.focal_px < _LARGEST and 0 <= self.gloss < math.inf
            whole = whole and str(self.source).isprintable()
        except (KeyError, IndexError, TypeError, ValueError, OverflowError):
            whole = False
        if not whole:
            raise InputError(
                f"{path}: not the numbers of a photograph of a face, or those of an older "
                "skylight; estimate the photograph again"
            )


def _three(numbers: Sequence[float]) -> Float[Tensor, "3"]:
    red, green, blue = numbers
    found = torch.tensor([red, green, blue], dtype=torch.float64)
    if not ((found > 0) & (found < _LARGEST)).all():
        raise ValueError("positive numbers are needed")
    return found


def _codes(photo: Path) -> UInt8[np.ndarray, "h w 3"]:
    """sRGB's codes of the linear values themselves, to which the light belongs: no tone map."""
    return tone_map(read_photo(photo).pixels, white=1.0)


def _named_lights(
    light: EnvironmentMap, lamps: tuple[Lamp, ...]
) -> tuple[EnvironmentMap, list[tuple[str, Lamp]]]:
    """The lamps, or the sun that the map shows, each with its name; and the rest of the map."""
    if lamps:
        named = [(f"lamp {number}", lamp) for number, lamp in enumerate(lamps, start=1)]
        return without_lamps(light, lamps), named
    main, rest = split_main_light(light)
    if not main.visible:
        return light, []
    # a lobe as wide as its disc of four spreads is: see disc_diameter_rad
    sun = Lamp(
        direction=main.direction,
        irradiance=main.irradiance,
        spread_rad=float(SUN_RADIUS_RAD) / 2,
    )
    return rest, [("sun", sun)]
