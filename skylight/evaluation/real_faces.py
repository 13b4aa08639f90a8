"""Light from photographs of people; the notes beside them say which side it came from."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from skylight.errors import InputError
from skylight.evaluation.notes import side_of_light
from skylight.evaluation.pictures import beside, strip
from skylight.evaluation.run import Check, Item
from skylight.imaging.colour import tone_map
from skylight.imaging.files import write_png
from skylight.imaging.photo import read_photo
from skylight.inverse.estimate import Estimate
from skylight.inverse.photo import PhotoEstimate, estimate_light, estimate_photo
from skylight.models.shipped import LightName
from skylight.sphere.envmap import luminance

LINEAR: tuple[LightName, ...] = ("sh9", "sh25")
INDEX = "index.json"
BEHIND = "sun-back"  # the class of photographs with the sun behind the head


@dataclass(frozen=True, kw_only=True)
class RealFaces:
    """The photographs of ``data/index.json``: {file: {"light": class, "desc": note, ...}}.

    There is no true light to compare with, so this counts: probes that are finite, and lights
    that come from the side that the note names. ``every`` n-th photograph only.
    """

    data: Path
    every: int = 1
    seed: int = 0  # nothing is drawn
    name: str = "real-faces"

    def __post_init__(self) -> None:
        _read_index(self.data)

    def config(self) -> dict[str, object]:
        return {"data": str(self.data.resolve())}

    def items(self) -> list[str]:
        return sorted(_read_index(self.data))[:: self.every]

    def measure(self, item: str, picture: Path) -> Item:
        entry = _read_index(self.data)[item]
        photo = read_photo(self.data / item)
        ours = estimate_photo(photo, source=item)
        # two more lights at no cost, with the same transport: do the sides depend on the model?
        estimates: dict[str, Estimate] = {"autoencoder": ours.estimate}
        for method in LINEAR:
            estimates[method] = estimate_light(ours.view.observation, method)
        environments = {m: e.environment for m, e in estimates.items()}
        write_png(picture, beside(_face(ours), strip(None, environments), item))

        note = str(entry.get("desc", ""))
        side = None if entry.get("light") == BEHIND else side_of_light(note)
        metrics: dict[str, dict[str, float]] = {}
        for method, estimate in estimates.items():
            across = float(estimate.environment.mean_direction(upper_only=True)[0])
            metrics[method] = {
                "finite": float(bool(estimate.environment.radiance.isfinite().all())),
                "residual": estimate.faces[0].residual,
                "light_x": across,
            }
            if side is not None:
                metrics[method]["right_side"] = float((across > 0) == (side == "right"))
        metrics["autoencoder"]["seconds"] = sum(ours.seconds.values())
        facts: dict[str, object] = {
            "light": entry.get("light"),
            "note": note,
            "side": side,
            "light_x": metrics["autoencoder"]["light_x"],
            "facing_deg": float(np.degrees(ours.fit.facing_angle_rad)),
            "landmark_error": ours.fit.landmark_error,
            "seconds": ours.seconds,
            "advice": list(ours.estimate.advice),
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def checks(
        self, rows: dict[str, dict[str, dict[str, float]]], items: list[Item]
    ) -> dict[str, Check]:
        ours = rows.get("autoencoder", {})
        checks = {}
        if "finite" in ours:
            checks["probes without NaN or infinity"] = Check.at_least(ours["finite"]["mean"], 1.0)
        if "right_side" in ours:
            count = ours["right_side"]["n"]
            name = f"light from the side that the note names, of {count:.0f} photographs"
            checks[name] = Check.at_least(ours["right_side"]["mean"], 0.8)
        return checks


def _face(ours: PhotoEstimate) -> np.ndarray:
    """The picture, and beside it the face as the estimate renders it."""
    view = ours.view
    shown = view.image.clone()
    rows, columns = view.surface.pixels[view.used].unbind(1)
    shown[rows, columns] = ours.estimate.rendered
    white = float(luminance(view.image[rows, columns]).quantile(0.98))
    return np.hstack([tone_map(picture, white=white) for picture in (view.image, shown)])


@cache
def _read_index(data: Path) -> dict[str, dict]:
    path = data / INDEX
    try:
        index = json.loads(path.read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error})") from error
    if not isinstance(index, dict) or not all(isinstance(e, dict) for e in index.values()):
        raise InputError(f'{path}: expected {{"photo.jpg": {{"light": ..., "desc": ...}}, ...}}')
    if not index:
        raise InputError(f"{path}: names no photographs")
    return index
