"""An estimate of a portrait as a scene of Blender."""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.app.maps.estimated_light import head_file, read_light, read_numbers
from skylight.errors import InputError
from skylight.faces.observe import SKIN_GLOSS
from skylight.imaging.colour import tone_map
from skylight.imaging.photo import read_photo
from skylight.inverse.result import Lamp
from skylight.io.hdr import RGBE_MAX
from skylight.relight.lamp_lights import without_lamps
from skylight.relight.light_files.blender_scene import PortraitScene, write_blender_scene
from skylight.relight.main_light import split_main_light
from skylight.skies.sun import SUN_RADIUS_RAD
from skylight.sphere.envmap import EnvironmentMap
from skylight.work.results_folder import results_folder

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
