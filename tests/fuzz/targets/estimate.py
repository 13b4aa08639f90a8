"""The folder of an estimate, as it is read again: numbers and head, beside a map and a photograph.

Read for a page, for Blender and for other programs' lights.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from skylight.io._files import write_environment_map
from skylight.maps._estimated import MAP, NUMBERS, read_light
from skylight.maps._export import export_blender_scene
from skylight.maps._viewer import export_viewer
from skylight.sphere._envmap import EnvironmentMap
from tests.fuzz.files import PLACE, joined, parted, read_by_any

_HEAD, _PHOTO = "mesh.obj", "photo.png"
_ANGLES = {"azimuth_deg": 50.0, "zenith_deg": 35.0}
_FACE: dict[str, Any] = {
    "number": 1, "source": _PHOTO, "picture_px": [40, 33], "focal_length_px": 120.0,
    "albedo": [0.5, 0.4, 0.3], "gloss": 2.0, "residual": 0.1, "exposure": 1.0,
    "white_balance": [1.25, 1.0, 0.8], "edit": {"saturation": 1.1, "contrast": 0.9, "pivot": 0.3},
    "eyes": [0.0, 0.0, -1.0], "forward": [0.0, 0.0, 1.0],
}  # fmt: skip
_TOLD: dict[str, Any] = {
    "light": "lamps",
    "choice": {"probability": 0.9},
    "sun": _ANGLES,
    "lamps": [_ANGLES | {"irradiance": [1.0, 0.9, 0.7], "spread_deg": 5.0}],
    "white_balance": [1.25, 1.0, 0.8],
    "verdict": {
        "summary": "direction sure, brightness rough, colour rough", "doubt": "",
        "light": "hard light from the left", "direction": {"word": "sure", "reason": "within 9°"},
        "brightness": {"word": "rough", "reason": "a"}, "colour": {"word": "rough", "reason": "b"},
    },
    "posterior": {
        "is_seen": True, "share": 0.5,
        "region_radius_deg": 9.0, "region_edge_per_sr": 0.5,
        "region_parts": [_ANGLES | {"share": 0.5}],
    },
    "advice": ["grey picture"],
    "faces": [_FACE],
    "seconds": {"tracing light": 1.0},
    "sources": [_PHOTO],
}  # fmt: skip


def seeds() -> list[bytes]:
    head = b"v 0 0 -1\nv 0.1 0 -1\nv 0 0.1 -1\nf 1 2 3\n"
    sky = _TOLD | {"light": "autoencoder", "lamps": [], "choice": None}
    return [joined({NUMBERS: json.dumps(told).encode(), _HEAD: head}) for told in (_TOLD, sky)]


def read(content: bytes) -> None:
    folder, photo = _folder()
    members = parted(content)
    for name in (NUMBERS, _HEAD):
        (folder / name).write_bytes(members.get(name, b""))
    readers = (
        lambda: read_light(folder, "skylight"),
        lambda: export_viewer(folder, PLACE / "page.html", photo=photo),
        lambda: export_blender_scene(folder, PLACE / "blender_out"),
    )
    read_by_any(readers)


@cache
def _folder() -> tuple[Path, Path]:
    """An estimate's folder with what does not change, and its photograph."""
    folder, photo = PLACE / "estimate", PLACE / _PHOTO
    folder.mkdir(exist_ok=True)
    codes = np.random.default_rng(0).integers(0, 256, (33, 40, 3), dtype=np.uint8)
    Image.fromarray(codes).save(photo)
    light = EnvironmentMap(radiance=torch.ones(8, 16, 3))
    for name in (MAP, "posterior.exr"):
        write_environment_map(folder / name, light)
    return folder, photo
