"""The light of an uploaded photograph."""

import json
from pathlib import Path
from typing import Any, Literal

from skylight.app.estimate import estimate_with_steps
from skylight.app.results import write_results
from skylight.inverse.photo import PhotoEstimate
from skylight.models.shipped import LightName
from skylight.studio.uploads import open_photo, preview_scale
from skylight.studio.worker import Progress


def estimate_light(
    path: str,
    name: str,
    pixels: int,
    folder: str,
    face: int | Literal["all"],
    light: LightName,
    *,
    tell: Progress,
) -> dict[str, Any]:
    """estimate.json with the preview's camera and where the heads are; all files in ``folder``."""
    tell("reading the picture", 0.0)
    photo = open_photo(Path(path), name, pixels)
    result = estimate_with_steps(
        [photo], [name], light=light, face=face, device="cpu", progress=tell
    )
    tell("writing the results", 0.0)
    write_results(Path(folder), [photo], [name], result)
    described = json.loads((Path(folder) / "estimate.json").read_text(encoding="utf-8"))
    return described | _seen(result, preview_scale(photo))


def _seen(result: PhotoEstimate, scale: float) -> dict[str, Any]:
    """``camera``: that of the first head's fit, for the preview; ``faces_at``: their middles."""
    camera = result.fit.camera
    return {
        "camera": {
            "focal_px": scale * camera.focal_px,
            "width": round(scale * camera.width),
            "height": round(scale * camera.height),
            "principal": [scale * part for part in camera.center_px],
        },
        "faces_at": [{"position": seen.fit.vertices.mean(0).tolist()} for seen in result.seen],
    }
