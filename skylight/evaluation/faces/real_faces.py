"""Illumination from photographs of people, checked by notes on the side of the light."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from skylight.errors import InputError
from skylight.evaluation.faces.face_light import (
    choice_facts,
    light_by_method,
    observe_largest,
    seen_and_rendered,
)
from skylight.evaluation.faces.notes import side_of_light
from skylight.evaluation.faces.options import EstimateOptions
from skylight.evaluation.harness.data_folder import read_index
from skylight.evaluation.harness.pictures import beside, strip
from skylight.evaluation.harness.run import Check, Item
from skylight.imaging.photo import read_photo
from skylight.io.files import write_png
from skylight.models.names import LightName

OURS: LightName = "autoencoder"
PHOTO_METHODS: tuple[LightName, ...] = (OURS, "lamps", "auto", "sh9", "sh25")
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
    options: EstimateOptions = EstimateOptions()
    name: str = "real-faces"

    def __post_init__(self) -> None:
        _read_index(self.data)

    def config(self) -> dict[str, object]:
        return {"data": str(self.data.resolve())} | self.options.config()

    def items(self) -> list[str]:
        return sorted(_read_index(self.data))[:: self.every]

    def measure(self, item: str, picture: Path) -> Item:
        entry = _read_index(self.data)[item]
        photo = read_photo(self.data / item, require_colour=True)
        seconds: dict[str, float] = {}
        fit, view = observe_largest(photo, item, seconds)
        # with the same transport: do the sides depend on the model?
        estimates = light_by_method(view.observation, PHOTO_METHODS, seconds, self.options)
        ours = estimates[OURS]
        environments = {m: e.environment for m, e in estimates.items()}
        face = seen_and_rendered(view, ours.rendered)
        write_png(picture, beside(face, strip(None, environments), item))

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
        others = sum(seconds[method] for method in PHOTO_METHODS if method != OURS)
        metrics[OURS]["seconds"] = sum(seconds.values()) - others
        facts: dict[str, object] = {
            "light": entry.get("light"),
            "note": note,
            "side": side,
            "light_x": metrics[OURS]["light_x"],
            "facing_deg": float(np.degrees(fit.facing_angle_rad)),
            "landmark_error": fit.landmark_error,
            "seconds": seconds,
            "verdicts": {name: one.posterior.verdict for name, one in estimates.items()},
            **choice_facts(estimates),
            "advice": list(ours.advice),
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def checks(
        self, rows: dict[str, dict[str, dict[str, float]]], items: list[Item]
    ) -> dict[str, Check]:
        ours = rows.get(OURS, {})
        checks = {}
        if "finite" in ours:
            checks["probes without NaN or infinity"] = Check.at_least(ours["finite"]["mean"], 1.0)
        if "right_side" in ours:
            count = ours["right_side"]["n"]
            name = f"light from the side that the note names, of {count:.0f} photographs"
            checks[name] = Check.at_least(ours["right_side"]["mean"], 0.8)
        return checks


@cache
def _read_index(data: Path) -> dict[str, dict]:
    path = data / INDEX
    index = read_index(path)
    if not isinstance(index, dict) or not all(isinstance(e, dict) for e in index.values()):
        raise InputError(f'{path}: expected {{"photo.jpg": {{"light": ..., "desc": ...}}, ...}}')
    if not index:
        raise InputError(f"{path}: names no photographs")
    return index
