"""Sensitivity to resolution, pose and shape (thesis, 5.5.5, Figs. 5.8, B.5 to B.7).

Light is estimated from heads with errors of known size and from smaller pictures. As in the thesis
every curve starts from the true head. All methods share one transport per condition.
"""

import zlib
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import cv2
import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from skylight._names import LightName
from skylight.evaluation._known_faces import (
    FIRST_SEED,
    METHODS,
    FaceSource,
    KnownFace,
    KnownFaceEvaluation,
    light_of,
)
from skylight.evaluation._pictures import NAMES, save_figure
from skylight.evaluation._run import Check, Item, Rows
from skylight.evaluation._tables import LABELS, METRICS
from skylight.faces._fit import FaceFit, camera_project
from skylight.faces._model import HeadModel, Region
from skylight.transport._cameras import Camera

Factor = Literal["size", "yaw", "pitch", "shape"]
_AXES = {"yaw": "y", "pitch": "x"}  # of the camera's frame: vertical, horizontal


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One point of a curve: a picture's side in pixels, degrees, or standard deviations."""

    factor: Factor
    value: float

    @property
    def label(self) -> str:
        return f"{self.factor} {self.value:g}"


def perturbed(face: KnownFace, condition: Condition, noise_seed: int) -> KnownFace:
    """The face with its ``truth`` (or its picture) changed; its light stays."""
    if condition.factor == "size":
        return resampled(face, round(condition.value))
    if condition.factor == "shape":
        return replace(face, truth=misshapen(face.truth, condition.value, noise_seed))
    turned = turned_head(face.truth, _AXES[condition.factor], condition.value)
    return replace(face, truth=turned)


def turned_head(fit: FaceFit, axis: str, angle_deg: float) -> FaceFit:
    """The head turned about an axis of the camera's frame through its own centre.

    R' = P R, x' = P (x - t) + t with t where the centre of the head is: the centre stays where
    it was in the picture.
    """
    turn = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    vertices = (fit.vertices - fit.translation) @ turn.T + fit.translation
    return replace(fit, rotation=turn @ fit.rotation, vertices=vertices)


def misshapen(fit: FaceFit, sigma: float, seed: int) -> FaceFit:
    """``sigma`` times standard normal noise on every identity and expression coefficient.

    One ``seed`` gives one direction of error, which grows with sigma.
    """
    rng = np.random.default_rng(seed)
    identity = fit.identity + sigma * rng.standard_normal(len(fit.identity))
    expression = fit.expression + sigma * rng.standard_normal(len(fit.expression))
    shape = HeadModel.load().vertices(identity, expression)
    return replace(
        fit,
        identity=identity,
        expression=expression,
        vertices=shape @ fit.rotation.T + fit.translation,
    )


def resampled(face: KnownFace, side: int) -> KnownFace:
    """The (square) picture as one of ``side`` x ``side`` pixels, by area; its camera with it."""
    camera = face.truth.camera
    ratio = side / camera.width
    small = cv2.resize(face.picture.numpy(), (side, side), interpolation=cv2.INTER_AREA)
    share = cv2.resize(
        face.clipped.numpy().astype(np.float32), (side, side), interpolation=cv2.INTER_AREA
    )
    encoded = cv2.resize(face.encoded, (side, side), interpolation=cv2.INTER_AREA)
    scaled = Camera(
        focal_px=camera.focal_px * ratio,
        width=side,
        height=side,
        center_px=(camera.center_px[0] * ratio, camera.center_px[1] * ratio),
    )
    return replace(
        face,
        encoded=encoded,
        picture=torch.from_numpy(small),
        clipped=torch.from_numpy(share > 0),
        truth=replace(face.truth, camera=scaled),
    )


def face_height_px(fit: FaceFit) -> int:
    """How many pixels high the skin of the face is in its picture."""
    skin = HeadModel.load().regions == Region.FACE
    return round(float(np.ptp(camera_project(fit.camera, fit.vertices[skin])[:, 1])))


Curves = dict[str, dict[str, dict[str, list[tuple[float, float]]]]]
_CURVE_AXES = {
    "size": "side of the picture, pixels",
    "pose": "pose error, degrees (mean of both axes)",
    "shape": "noise of the shape, standard deviations",
}
_FIGURES = {"size": "figure_b_5", "pose": "figure_b_6", "shape": "figure_b_7"}
_HEADLINE = "full_dw_mae"


def write_sensitivity(out: Path, curves: Curves) -> list[Path]:
    """Full-dω MAE over each factor (``figure_5_8.png``), and all metrics over one factor each."""
    there = [factor for factor in _CURVE_AXES if factor in curves]
    written = [_write(out / "figure_5_8.png", [(factor, _HEADLINE) for factor in there], curves, 1)]
    for factor in there:
        panels = [(factor, metric) for metric in METRICS if metric in curves[factor]]
        written.append(_write(out / f"{_FIGURES[factor]}.png", panels, curves, 2))
    return written


def _write(path: Path, panels: list[tuple[str, str]], curves: Curves, rows: int) -> Path:
    columns = -(-len(panels) // rows)
    figure = Figure(figsize=(4 * columns, 3.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for place, (factor, metric) in zip(axes.flat, panels, strict=False):
        for method, points in curves[factor][metric].items():
            place.plot(*zip(*points, strict=True), marker="o", ms=3, label=NAMES[method])
        place.set_xlabel(_CURVE_AXES[factor])
        place.set_title(LABELS[metric], fontsize=10)
        place.set_ylim(bottom=0)
        place.grid(alpha=0.3)
    for place in axes.flat[len(panels) :]:
        place.axis("off")
    axes.flat[0].legend(fontsize=8)
    save_figure(path, figure)
    return path


SIZES = (90, 128, 192, 256, 360)
ANGLES_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
SIGMAS = (0.0, 0.275, 0.55, 0.825, 1.1)
UNCHANGED = "unchanged"  # the row that the curves of pose and shape start from
MOST_GROWTH = 0.2  # of Full-dω MAE


@dataclass(frozen=True, kw_only=True)
class FaceSensitivity(KnownFaceEvaluation):
    """The seven metrics over picture size, two axes of pose error and noise of the shape.

    Of the first ``count`` faces of the folder ``data``, or of so many that are rendered here, whose
    pictures have ``size`` pixels a side. Sizes beyond a folder's pictures are
    left out: there is nothing more to see in a picture blown up. In pictures resampled to one of
    ``sizes`` every pixel counts; the other curves use the usual working resolution.
    """

    title = "face-sensitivity"
    data_folder = None
    quick = MappingProxyType(
        {
            "count": 3,
            "methods": ("sh9", "autoencoder"),
            "sizes": (90, 192),
            "angles_deg": (0.0, 15.0),
            "sigmas": (0.0, 1.1),
        }
    )

    data: Path | None = None
    count: int | None = 24
    size: int = max(SIZES)
    seed: int = FIRST_SEED
    sizes: tuple[int, ...] = SIZES
    angles_deg: tuple[float, ...] = ANGLES_DEG
    sigmas: tuple[float, ...] = SIGMAS
    methods: tuple[LightName, ...] = METHODS

    @property
    def source(self) -> FaceSource:
        return FaceSource(data=self.data, count=self.count, size=self.size, seed=self.seed)

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
