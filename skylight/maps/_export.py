"""Light exported for other programs: a map, or an estimate with its lamps and its portrait.

:func:`export_light` writes files of any program, :func:`export_blender_scene` all that Blender's
extension sets up for a portrait: light, camera, head and photograph.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from skylight._names import (
    PLAIN_READING,
    Convention,
    HarmonicConvention,
    LightTarget,
    MapReading,
)
from skylight.errors import InputError
from skylight.faces._observe import SKIN_SPECULAR
from skylight.imaging._colour import tone_map
from skylight.imaging._photo import read_photo
from skylight.inverse._result import Lamp
from skylight.io._hdr import RGBE_MAX
from skylight.maps._estimated import head_file, luminance_of_1, picked, read_light, read_numbers
from skylight.relight._blender import (
    WHITE_PAINT,
    PortraitScene,
    write_blender,
    write_blender_scene,
)
from skylight.relight._compact import compact_lights
from skylight.relight._gltf import LAST_SIZE, write_gltf
from skylight.relight._harmonics import (
    write_augmented_reality,
    write_harmonics,
    write_threejs,
)
from skylight.relight._lamps import split_main_light, without_lamps
from skylight.relight._scenes import write_mitsuba, write_usd
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap
from skylight.work._resumable import results_folder

WHOLE = {"sh", "ar"}  # targets that have no lights of an artist's own to move
LARGEST_FACE = 2048
MOST_LAMPS = 8
BRIGHTEST = 1e30  # radiance: sums over the sphere are float32 in files


@dataclass(frozen=True, kw_only=True)
class ExportedLight:
    """What was written: ``cut`` is the share of the light that light.glb's reflections lack.

    ``lamps`` became lights of their own. ``cut_off``: as :class:`CompactLights` has it.
    """

    files: list[str]
    lamps: tuple[Lamp, ...]
    cut: float
    cut_off: bool = False


def export_light(
    probe: Path,
    out: Path,
    targets: Sequence[LightTarget],
    *,
    convention: Convention = "skylight",
    harmonics: HarmonicConvention = "skylight",
    lamps: int | None = None,
    face: int | None = None,
    reading: MapReading = PLAIN_READING,
) -> ExportedLight:
    """Write the files of each target into the folder ``out``.

    ``probe`` is a map, or an estimate's folder or estimate.json: its lamps are lights of their own
    of all targets but "sh" and "ar", beside the rest of its map. So are, of a map, as many as
    ``lamps`` of its strongest compact lights (:func:`skylight.relight._compact.compact_lights`).

    ``face`` is the side of a cube map's faces, a power of two from 32; by default the largest that
    shows no more detail than the map's horizon, from 64 to 512. A sky alone gets a black lower
    half.

    Raises
    ------
    InputError
        A map or estimate that cannot be read or is too bright, no target, or a face size that
        cannot be.
    """
    if not targets:
        raise InputError("name at least one target with --as")
    if face is not None and (face & (face - 1) or not 2 * LAST_SIZE <= face <= LARGEST_FACE):
        raise InputError(
            f"a cube map's faces are a power of two from {2 * LAST_SIZE} to {LARGEST_FACE} pixels "
            f"wide, not {face}"
        )
    light, listed = read_light(probe, convention, reading)
    if (most := float(light.radiance.max())) > BRIGHTEST:
        raise InputError(
            f"{probe}: radiance of up to {most:.3g}, whose sums no other program holds; scale it "
            f"down: skylight convert {probe} --scale 1e-10"
        )
    cut_off, has_lights = False, bool(set(targets) - WHOLE)
    if lamps is not None:
        if listed:
            raise InputError(
                f"{probe}: the lamps of an estimate are those it lists: leave --lamps out"
            )
        if not 0 <= lamps <= MOST_LAMPS:
            raise InputError(f"0 to {MOST_LAMPS} lamps are taken out of a map, not {lamps}")
        if not has_lights:
            raise InputError(
                f"{' and '.join(targets)} have all light in one: leave --lamps out, or name a "
                "target that has lamps"
            )
    if not has_lights:
        separate, rest = (), light
    elif lamps is None:
        separate, rest = listed, without_lamps(light, listed)
    else:
        compact = compact_lights(light, lamps)
        separate, rest, cut_off = tuple(compact.lamps), compact.rest, compact.cut_off
    size, unit = face or default_face(light), luminance_of_1(probe)
    written: list[str] = []
    cut = 0.0
    with results_folder(out) as folder:
        for target in dict.fromkeys(targets):
            if target == "threejs":
                written += write_threejs(folder, rest, separate, cd_per_m2=unit)
            elif target == "sh":
                written += write_harmonics(folder, light, harmonics, cd_per_m2=unit)
            elif target == "ar":
                written += write_augmented_reality(folder, light, size, cd_per_m2=unit)
            elif target == "gltf":
                files, cut = write_gltf(folder, rest, size, separate, cd_per_m2=unit)
                written += files
            elif target == "usd":
                written += write_usd(folder, rest, separate, cd_per_m2=unit)
            elif target == "mitsuba":
                written += write_mitsuba(folder, rest, separate, cd_per_m2=unit)
            else:
                written += write_blender(folder, rest, separate, cd_per_m2=unit)
    return ExportedLight(files=written, lamps=separate, cut=cut, cut_off=cut_off)


def default_face(light: EnvironmentMap) -> int:
    """A quarter of the horizon's pixels, rounded up to a power of two between 64 and 512."""
    quarter = light.layout[1] // 4
    return min(512, max(64, 1 << (quarter - 1).bit_length()))


MOST_REFLECTED = 0.99  # at normal incidence: no index of refraction reflects all
_LARGEST = 1e6  # of albedos and white balances, of sides and focal lengths in pixels
_RGB = [float, float, float]
_NEEDED = {
    "faces": [
        {
            "source": str,
            "picture_px": [int, int],
            "focal_length_px": float,
            "albedo": _RGB,
            "gloss": float,
        }
    ],
    "white_balance": _RGB,
    "verdict": {"summary": str},
    "advice": [str],
}


def export_blender_scene(estimate: Path, out: Path, *, photo: Path | None = None) -> list[str]:
    """Write what the extension of Blender sets up, and return the files' names.

    The sun, or an estimate's lamps, are lights of their own and the map is the rest. All light is
    multiplied by the picture's white balance, so that a surface of albedo a shows a / pi times its
    irradiance in the photograph's own linear values. ``white`` in the scene's file is that of white
    paint which faces the camera: 0.8 / pi times its irradiance. Of several faces, the first one
    counts, with its photograph.

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
    told = _checked(numbers, content)
    face = told["faces"][0]
    picture = photo or _where_it_was(Path(face["source"]), numbers)
    if not os.path.isfile(picture):  # Path's raises for names that cannot be
        raise InputError(f"{picture}: the photograph is not there; say where it is with --photo")
    # sRGB's codes of the linear values themselves, to which the light belongs: no tone map
    codes = tone_map(read_photo(picture).pixels, white=1.0)
    height, width = codes.shape[:2]
    if [width, height] != face["picture_px"]:
        raise InputError(
            f"{picture}: {width} x {height} pixels, and the estimate is of a photograph of "
            f"{face['picture_px'][0]} x {face['picture_px'][1]}; give that with --photo"
        )
    light, lamps = read_light(numbers, "skylight")
    brightest = max([light.radiance.max(), *(lamp.irradiance.max() for lamp in lamps)])
    if brightest > RGBE_MAX / _LARGEST:  # so that it is finite times the white balance
        raise InputError(f"{numbers}: radiance of {brightest:.3g} is no light; estimate again")
    ambient, named = _named_lights(light, lamps)
    head = head_file(numbers, 0, of=len(told["faces"]))
    shown = torch.tensor(told["white_balance"], dtype=torch.float64)
    scene = PortraitScene(
        ambient=EnvironmentMap(radiance=ambient.radiance * shown.to(ambient.radiance)),
        lamps=[(name, replace(each, irradiance=each.irradiance * shown)) for name, each in named],
        photograph=codes,
        focal_px=face["focal_length_px"],
        head=head,
        albedo=torch.tensor(face["albedo"], dtype=torch.float64),
        specular=replace(SKIN_SPECULAR, f0=min(face["gloss"] * SKIN_SPECULAR.f0, MOST_REFLECTED)),
        white=WHITE_PAINT / math.pi * light.irradiance(torch.tensor([0.0, 0.0, 1.0])) * shown,
        verdict=told["verdict"]["summary"],
        advice=told["advice"],
        cd_per_m2=luminance_of_1(numbers),
    )
    with results_folder(out) as folder:
        return write_blender_scene(folder, scene)


def _where_it_was(source: Path, numbers: Path) -> Path:
    beside = numbers.resolve().parent.parent / source  # as it is where it is absolute
    return beside if os.path.isfile(beside) and not os.path.isfile(source) else source


def _checked(path: Path, content: dict[str, Any]) -> dict[str, Any]:
    """What is needed of estimate.json."""
    try:
        told = picked(content, _NEEDED, "")
        face = told["faces"][0]
        positive = [
            *face["picture_px"], face["focal_length_px"], *face["albedo"], *told["white_balance"]
        ]  # fmt: skip
        whole = all(0 < number < _LARGEST for number in positive)
        whole = whole and face["gloss"] >= 0 and face["source"].isprintable()
    except (IndexError, ValueError):
        whole = False
    if not whole:
        raise InputError(
            f"{path}: not the numbers of a photograph of a face, or those of an older skylight; "
            "estimate the photograph again"
        )
    return told


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
