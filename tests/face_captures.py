"""A folder of captures made in-house: a rendered person, and its mirror image."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from skylight.faces._captures import CAPTURES_NAME
from skylight.faces._synthetic import SyntheticFace, render_face
from skylight.io._files import write_environment_map, write_png
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles

PHOTO, MIRRORED = "day/ada.png", "day/bob.png"
TURNS_DEG = {PHOTO: 39 * 2.8125, MIRRORED: -12 * 2.8125}  # of the probes, against their photographs


@dataclass(frozen=True, kw_only=True)
class MadeCaptures:
    """The folder, and the face whose picture and light lie in it."""

    folder: Path
    face: SyntheticFace


def make_captures(folder: Path) -> MadeCaptures:
    """Two captures without azimuth; the second, of no visible sun by its row, mirrors the first."""
    grid = DirectionGrid.latlong(16, 64)
    angles = torch.tensor([math.radians(40.0), math.radians(55.0)], dtype=torch.float64)
    towards_sun = grid.directions @ direction_from_angles(angles[0], angles[1])
    sun = 250 * torch.exp(300 * (towards_sun[:, None] - 1)) * torch.tensor([1.0, 0.9, 0.75])
    sky = (0.5 + 0.5 * grid.directions[:, 1:2]) * torch.tensor([0.5, 0.7, 1.0]) + sun
    face = render_face(
        EnvironmentMap(radiance=sky.float().reshape(16, 64, 3)),
        torch.tensor([0.2, 0.2, 0.15]),
        seed=3,
        size=144,
        azimuth_rad=0.0,
        light_rows=32,
    )
    (folder / "day").mkdir(parents=True)
    pictures = {PHOTO: face.encoded, MIRRORED: np.ascontiguousarray(face.encoded[:, ::-1])}
    light = face.environment.radiance
    lights = {PHOTO: light, MIRRORED: light.flip(1)}
    for photo, turn in TURNS_DEG.items():
        write_png(folder / photo, pictures[photo])
        truth = EnvironmentMap(radiance=7 * lights[photo])  # of another exposure
        probe = truth.rotate_azimuth(-math.radians(turn))
        write_environment_map((folder / photo).with_suffix(".exr"), probe)
    (folder / CAPTURES_NAME).write_text(
        "person,photo,probe,azimuth_deg,visible_sun,place\n"
        f'Ada,{PHOTO},day/ada.exr,,1,"lawn, north"\n'
        f"Bob,{MIRRORED},day/bob.exr,,0,\n"
    )
    return MadeCaptures(folder=folder, face=face)
