"""Illumination from an uploaded photograph."""

import json
from pathlib import Path
from typing import Any, Literal

from skylight.app.estimate.photos import estimate_photo
from skylight.app.estimate.results import write_results
from skylight.app.estimate.types import PhotoEstimate
from skylight.models.names import LightName
from skylight.studio.tasks.lamps import keep_lamps
from skylight.studio.tasks.person import command_of, keep_person
from skylight.studio.tasks.uploads import open_photo, preview_scale
from skylight.work.progress import StageProgress


def estimate_light(
    path: str,
    name: str,
    pixels: int,
    folder: str,
    face: int | Literal["all"],
    light: LightName,
    model: str | None = None,
    *,
    tell: StageProgress,
) -> dict[str, Any]:
    """estimate.json with the preview's camera; all files in ``folder``.

    With lamps also how wide these are, and the ambient light's irradiance.
    """
    tell("reading the picture", 0.0)
    photo = open_photo(Path(path), name, pixels)
    result = estimate_photo(photo, names=[name], light=light, model=model, face=face, progress=tell)
    tell("writing the results", 0.0)
    write_results(Path(folder), result)
    # beside the folder, as the page offers all files in it
    keep_person(Path(folder).parent, result, command_of(name, light, face, model))
    described = json.loads((Path(folder) / "estimate.json").read_text(encoding="utf-8"))
    if result.estimate.lamps:
        described["lamp_facts"] = keep_lamps(Path(folder).parent, result)
    return described | {"camera": _preview_camera(result, preview_scale(photo))}


def _preview_camera(result: PhotoEstimate, scale: float) -> dict[str, Any]:
    """That of the first head's fit, for the preview."""
    camera = result.fit.camera
    return {
        "focal_px": scale * camera.focal_px,
        "width": round(scale * camera.width),
        "height": round(scale * camera.height),
        "principal": [scale * part for part in camera.center_px],
    }
