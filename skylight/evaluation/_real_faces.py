"""Illumination from photographs of people.

Where a light probe was captured with each photograph the estimates are scored by it (thesis,
5.5.4, Table 5.3, Fig. 5.7); where there are but notes on the light, by the side that a note names.
Sides are the viewer's: "right" is +X of the camera's frame.
"""

import hashlib
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import UInt8

from skylight._names import DEFAULT_LIGHT, LightName
from skylight.errors import InputError
from skylight.evaluation._known_faces import (
    METHODS,
    FaceEvaluation,
    choice_facts,
    light_by_method,
    observe_largest,
    seen_and_rendered,
)
from skylight.evaluation._pictures import PROBE, SCENE, WIDTH, beside, caption, sized, strip
from skylight.evaluation._run import Check, Evaluation, Item, Rows, read_index
from skylight.faces._captures import (
    CAPTURES_NAME,
    FaceCapture,
    capture_hash,
    read_captures,
    true_light,
)
from skylight.imaging._colour import tone_map
from skylight.imaging._photo import read_photo
from skylight.inverse._scores import score
from skylight.io._files import write_png
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._scene import evaluation_scene

Side = Literal["left", "right"]
_OTHER: dict[str, Side] = {"left": "right", "right": "left"}
_SIDE = "(left|right)"
# "from viewer's left", "from front/upper left", "light front/left", "slightly viewer's right"
_TOWARDS = re.compile(
    rf"\b(?:from|slightly|light)\s+(?:the\s+)?(?:viewer's\s+)?(?:\w+/)?(?:upper\s+)?{_SIDE}\b"
)
# "lit left cheek", "right cheek brighter", "both cheeks lit, left one brighter"
_LIT = re.compile(rf"\blit {_SIDE}\b|\b{_SIDE} (?:cheek|one|side) (?:brighter|lighter)\b")
# "right side darker", "right cheek and neck darker", "right half nearly black"
_DARK = re.compile(
    rf"\b{_SIDE} (?:cheek|side|half)(?: and neck)? (?:nearly )?(?:darker|dark|black)\b"
)


def side_of_light(note: str) -> Side | None:
    """The side named by a note; None where it names none, both, or light from behind.

    Light from behind is left out: it reaches the face round its edge, or not at all.
    """
    text = note.lower()
    if re.search(r"\bbehind\b|\btwo sides\b", text):
        return None
    sides: set[str] = {m.group(1) for m in _TOWARDS.finditer(text)}
    sides |= {m.group(1) or m.group(2) for m in _LIT.finditer(text)}
    sides |= {_OTHER[m.group(1)] for m in _DARK.finditer(text)}
    return sides.pop() if len(sides) == 1 else None  # type: ignore[return-value]


OURS = DEFAULT_LIGHT
PHOTO_METHODS: tuple[LightName, ...] = (OURS, "autoencoder", "lamps", "auto", "sh9", "sh25")
INDEX = "index.json"
BEHIND = "sun-back"  # the class of photographs with the sun behind the head


@dataclass(frozen=True, kw_only=True)
class RealFaces(FaceEvaluation):
    """The photographs of ``data/index.json``: {file: {"light": class, "desc": note, ...}}.

    There is no true light to compare with, so this counts: probes that are finite, and lights
    that come from the side that the note names. ``every`` n-th photograph only.
    """

    title = "real-faces"
    needs = "photographs with a captures.csv (the true light is known) or an index.json (notes)"
    data_folder = "faces"
    quick = MappingProxyType({"every": 3})
    selects = ("every",)

    data: Path
    every: int = 1

    def __post_init__(self) -> None:
        _read_index(self.data)

    @classmethod
    def over(cls, data: Path | None, *, quick: bool = False) -> Evaluation:
        """Of captures where the folder has a list of them, else of photographs with notes."""
        if data is not None and (data / CAPTURES_NAME).is_file():
            return CapturedFaces.over(data, quick=quick)
        return super().over(data, quick=quick)

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
            "verdicts": {name: one.verdict.summary for name, one in estimates.items()},
            **choice_facts(estimates),
            "advice": list(ours.advice),
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
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


OF_SCALE = ("brightness", "mae_aligned", "rmse_aligned")  # which is aligned before


@dataclass(frozen=True, kw_only=True)
class CapturedFaces(FaceEvaluation):
    """The photographs of ``data/captures.csv``, each ``every``-th, against their probes.

    Photograph and probe come from different exposures, so brightness cannot be compared: every
    light is scaled to the true mean shading ("mapping the average image intensity to 1", thesis,
    5.5.1) before errors of shading are taken. What speaks of the sun is left out where the
    capture says that none was visible.
    """

    title = "captured-faces"
    quick = RealFaces.quick
    selects = ("data", "every")

    data: Path
    every: int = 1
    methods: tuple[LightName, ...] = (OURS, *METHODS)

    def __post_init__(self) -> None:
        unknown = [c.photo for c in self._captures().values() if c.azimuth_deg is None]
        if unknown:
            raise InputError(
                f"{self.data / CAPTURES_NAME}: {len(unknown)} of its photographs have no "
                f"azimuth_deg ({unknown[0]} is the first); find it by `skylight faces "
                f"calibrate-azimuth {self.data}`"
            )

    def config(self) -> dict[str, object]:
        digest = hashlib.sha256()
        for capture in self._captures().values():
            digest.update(f"{capture} {capture_hash(self.data, capture)}".encode())
        return super().config() | {"captures": digest.hexdigest()}

    def items(self) -> list[str]:
        return list(self._captures())[:: self.every]

    def measure(self, item: str, picture: Path) -> Item:
        capture = self._captures()[item]
        truth = true_light(self.data, capture)
        photo = read_photo(self.data / item, require_colour=True)
        fit, view = observe_largest(photo, str(self.data / item))
        found = {m: self.options.estimate(view.observation, m) for m in self.methods}
        environments = {m: estimate.environment for m, estimate in found.items()}
        picture.parent.mkdir(parents=True, exist_ok=True)  # photographs may lie in sub-folders
        seen = tone_map(view.image)
        write_png(picture, beside(seen, figure_columns(truth, environments), item))
        facts: dict[str, object] = {
            "person": capture.person,
            "visible_sun": capture.visible_sun,
            "azimuth_deg": capture.azimuth_deg,
            "landmark_error": fit.landmark_error,
        }
        return Item(
            name=item,
            metrics={m: aligned_scores(e, truth, capture) for m, e in environments.items()},
            facts=facts,
        )

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        """In the thesis the autoencoder has the best shading and the best sun."""
        checks = {}
        for name in (OURS, "autoencoder"):
            ours = rows.get(name, {})
            for metric in ("si_rmse", "full_dw_mae", "sun_dw_mae"):
                for other in (m for m in ("sh9", "sh25") if metric in ours and m in rows):
                    checks[f"{name} {metric} below {other}"] = Check.below(
                        ours[metric]["mean"], rows[other][metric]["mean"], other
                    )
        return checks

    def _captures(self) -> dict[str, FaceCapture]:
        return {capture.photo: capture for capture in read_captures(self.data)}


def aligned_scores(
    estimate: EnvironmentMap, truth: EnvironmentMap, capture: FaceCapture
) -> dict[str, float]:
    """:func:`score` of the estimate scaled to the true mean shading, without what tells scale."""
    scene = evaluation_scene()
    factor = scene.shade(truth).mean() / scene.shade(estimate).mean().clamp(min=1e-12)
    scaled = EnvironmentMap(radiance=estimate.radiance * factor)
    scores = score(scaled, truth, sun_visible=capture.visible_sun)
    return {k: v for k, v in scores.items() if k not in OF_SCALE}


def figure_columns(
    truth: EnvironmentMap, estimates: dict[str, EnvironmentMap]
) -> UInt8[np.ndarray, "h w 3"]:
    """Fig. 5.7: truth first, then each method; diffuse things, the light, specular things.

    Each column is exposed for the same mean shading of the diffuse things.
    """
    scene = evaluation_scene()
    columns = []
    for name, environment in ({"truth": truth} | estimates).items():
        mean = float(luminance(scene.shade(environment)).mean())
        diffuse = tone_map(scene.relight(environment), white=2 * mean)
        light = tone_map(environment.radiance, white=3 * mean)
        specular = tone_map(scene.relight_specular(environment), white=3 * mean)
        rows = [
            sized(diffuse, WIDTH, SCENE),
            sized(light, WIDTH, PROBE),
            sized(specular, WIDTH, SCENE),
        ]
        columns.append(np.vstack([caption(name, WIDTH), *rows]))
    return np.hstack(columns)
