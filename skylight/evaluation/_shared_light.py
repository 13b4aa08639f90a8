"""One illumination estimated from several faces jointly."""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np

from skylight.errors import InputError
from skylight.evaluation._known_faces import (
    FaceSource,
    KnownFaceEvaluation,
    face_score,
    fitted_head,
    peak_mib,
    stage,
)
from skylight.evaluation._pictures import beside, strip
from skylight.evaluation._run import Check, Item, Rows
from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.io._files import write_png

TOGETHER = 4
COUNTS = (1, 2, 4)
BETTER = 0.6  # mean sun angle of four faces over that of one


@dataclass(frozen=True, kw_only=True)
class SharedLight(KnownFaceEvaluation):
    """The default light from one, two and four of a scene's first four faces.

    ``data`` is a folder of ``skylight faces render --per-scene 4``: the faces of a scene share
    light, camera and exposure, as those in one photograph do. A scene's row for one face is the
    mean over its four, that for two the mean over two pairs. ``scenes`` takes the first so many.
    """

    title = "shared-light"
    needs = "faces in scenes of four, made by 'skylight faces render --per-scene 4'"
    data_folder = "scenes"
    quick = MappingProxyType({"scenes": 8})
    selects = ("data", "scenes", "seed")

    data: Path
    scenes: int | None = None

    def __post_init__(self) -> None:
        _ = self.names  # refuses a folder that cannot be used before anything is measured

    @property
    def source(self) -> FaceSource:
        return FaceSource(data=self.data, count=None)

    @cached_property
    def names(self) -> dict[str, list[str]]:
        """scene -> its first four faces, of the scenes that have so many."""
        found: dict[str, list[str]] = defaultdict(list)
        for name in self.source.names():
            found[f"scene{self.source.scene(name):04d}"].append(name)
        whole = {s: faces[:TOGETHER] for s, faces in found.items() if len(faces) >= TOGETHER}
        if not whole:
            raise InputError(
                f"{self.data}: no scene has {TOGETHER} faces; render with --per-scene {TOGETHER}"
            )
        return whole

    def items(self) -> list[str]:
        return list(self.names)[: self.scenes]

    def measure(self, item: str, picture: Path) -> Item:
        faces = [self.source.read(name) for name in self.names[item]]
        seconds: dict[str, float] = {}
        observations = []
        for name, face in zip(self.names[item], faces, strict=True):
            try:
                fit = fitted_head(face, seconds)
            except InputError as error:
                raise InputError(f"{name}: {error}") from error
            with stage(seconds, "transport"):
                view = observe_face(face.picture, face.clipped, HeadModel.load(), fit)
            observations.append(view.observation)
        metrics, first = {}, {}
        for count in COUNTS:
            label = row(count)
            with stage(seconds, label):
                estimates = [
                    self.options.estimate(observations[i : i + count], self.options.light)
                    for i in range(0, TOGETHER, count)
                ]
            first[label] = estimates[0].environment
            each = [face_score(estimate.environment, faces[0]) for estimate in estimates]
            metrics[label] = {k: float(np.mean([scores[k] for scores in each])) for k in each[0]}
            metrics[label]["seconds"] = seconds[label] / len(estimates)
        seen = np.hstack([face.encoded for face in faces])
        write_png(picture, beside(seen, strip(faces[0].environment, first), item))
        facts: dict[str, object] = {
            "sun_visible": faces[0].sun_visible,
            "seconds": seconds,
            "peak_mib": peak_mib(),
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        angle = "sun_angle_deg"
        one, four = rows.get(row(1), {}), rows.get(row(TOGETHER), {})
        if angle not in one or angle not in four:
            return {}
        ratio = four[angle]["mean"] / one[angle]["mean"]
        return {"mean sun angle, four faces over one": Check.at_most(ratio, BETTER)}


def row(count: int) -> str:
    return f"{count} face" if count == 1 else f"{count} faces"
