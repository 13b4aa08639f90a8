"""Sensitivity to resolution, pose and shape (thesis, 5.5.5, Figs. 5.8, B.5 to B.7).

As in the thesis every curve starts from the true head. All methods share one transport per
condition.
"""

import zlib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skylight.evaluation.faces.face_light import METHODS, light_of
from skylight.evaluation.faces.face_perturbation import Condition, Factor, face_height_px, perturbed
from skylight.evaluation.faces.known_faces import FaceSource
from skylight.evaluation.faces.options import EstimateOptions
from skylight.evaluation.faces.sensitivity_curves import write_sensitivity
from skylight.evaluation.harness.run import Check, Item
from skylight.evaluation.harness.tables import Rows
from skylight.evaluation.harness.thesis_figures import METRICS
from skylight.models.names import LightName

SIZES = (90, 128, 192, 256, 360)
ANGLES_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
SIGMAS = (0.0, 0.275, 0.55, 0.825, 1.1)
UNCHANGED = "unchanged"  # the row that the curves of pose and shape start from
MOST_GROWTH = 0.2  # of Full-dω MAE


@dataclass(frozen=True, kw_only=True)
class FaceSensitivity:
    """The seven metrics over picture size, two axes of pose error and noise of the shape.

    Rendered here, pictures have the largest size's side. Sizes beyond a folder's pictures are
    left out: there is nothing more to see in a picture blown up. In pictures resampled to one of
    ``sizes`` every pixel counts; the other curves use the usual working resolution.
    """

    source: FaceSource
    sizes: tuple[int, ...] = SIZES
    angles_deg: tuple[float, ...] = ANGLES_DEG
    sigmas: tuple[float, ...] = SIGMAS
    methods: tuple[LightName, ...] = METHODS
    options: EstimateOptions = EstimateOptions()
    name: str = "face-sensitivity"

    @property
    def seed(self) -> int:
        return self.source.seed

    def config(self) -> dict[str, object]:
        return self.source.config() | {
            "sizes": list(self.sizes),
            "angles_deg": list(self.angles_deg),
            "sigmas": list(self.sigmas),
            "methods": list(self.methods),
            **self.options.config(),
        }

    def items(self) -> list[str]:
        return self.source.names()

    def conditions(self, side: int) -> list[Condition | None]:
        """For pictures of so many pixels; None, the unchanged face, stands for all zeros."""
        values: dict[Factor, tuple[float, ...]] = {
            "size": tuple(float(s) for s in self.sizes if s <= side),
            "yaw": self.angles_deg,
            "pitch": self.angles_deg,
            "shape": self.sigmas,
        }
        changed = [Condition(factor=f, value=v) for f, each in values.items() for v in each if v]
        return [None, *changed]

    def measure(self, item: str, picture: Path) -> Item:
        face = self.source.read(item)
        metrics: dict[str, dict[str, float]] = {}
        seconds: dict[str, float] = {}
        for condition in self.conditions(face.truth.camera.width):
            label, changed, height = UNCHANGED, face, None
            if condition is not None:
                label = condition.label
                changed = perturbed(face, condition, noise_seed=zlib.crc32(item.encode()))
                if condition.factor == "size":
                    height = face_height_px(changed.truth)
            took: dict[str, float] = {}
            lit = light_of(
                changed,
                changed.truth,
                self.methods,
                took,
                face_height_px=height,
                options=self.options,
            )
            seconds[label] = sum(took.values())
            for method, values in lit.metrics.items():
                kept = {m: values[m] for m in METRICS if m in values}
                metrics[f"{method}, {label}"] = kept
        return Item(name=item, metrics=metrics, facts={"seconds": seconds})

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        metric, checks = "full_dw_mae", {}
        error = {
            name.removeprefix("autoencoder, "): row[metric]["mean"]
            for name, row in rows.items()
            if name.startswith("autoencoder, ")
        }
        at_15 = [error[f"{axis} 15"] for axis in ("yaw", "pitch") if f"{axis} 15" in error]
        if at_15:
            growth = float(np.mean(at_15)) / error[UNCHANGED] - 1
            name = "growth of the autoencoder's Full-dω MAE at a pose error of 15 degrees"
            checks[name] = Check.at_most(growth, MOST_GROWTH)
        sizes = sorted(int(label.split()[1]) for label in error if label.startswith("size "))
        if len(sizes) > 1:
            growth = error[f"size {sizes[0]}"] / error[f"size {sizes[-1]}"] - 1
            name = f"growth of the autoencoder's Full-dω MAE from {sizes[-1]} to {sizes[0]} pixels"
            checks[name] = Check.at_most(growth, MOST_GROWTH)
        return checks

    def illustrate(self, out: Path, rows: Rows, items: list[Item]) -> None:
        """``figure_5_8.png`` and one picture for each of Figs. B.5 to B.7."""
        write_sensitivity(out, curves(rows))


def curves(rows: Rows) -> dict[str, dict[str, dict[str, list[tuple[float, float]]]]]:
    """factor -> metric -> method -> (value, mean over faces); "pose" is the mean of both axes."""
    found: dict[str, dict[str, dict[str, dict[float, list[float]]]]] = defaultdict(
        lambda: defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
    )
    for name, row in rows.items():
        method, label = name.split(", ")
        if label == UNCHANGED:
            places = [("pose", 0.0), ("yaw", 0.0), ("pitch", 0.0), ("shape", 0.0)]
        else:
            factor, value = label.split()
            places = [(factor, float(value))]
            if factor in ("yaw", "pitch"):
                places.append(("pose", float(value)))
        for factor, value in places:
            for metric, statistics in row.items():
                found[factor][metric][method][value].append(statistics["mean"])
    return {
        factor: {
            metric: {
                method: sorted((value, float(np.mean(each))) for value, each in points.items())
                for method, points in methods.items()
            }
            for metric, methods in metrics.items()
        }
        for factor, metrics in found.items()
    }
