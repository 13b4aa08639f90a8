"""Illumination from photographs of faces under one lamp of known direction."""

import math
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight._names import DEFAULT_LIGHT, LightName
from skylight.errors import InputError
from skylight.evaluation._known_faces import (
    FaceEvaluation,
    choice_facts,
    coverage,
    lamps_chosen,
    light_by_method,
    observe_largest,
    seen_and_rendered,
)
from skylight.evaluation._pictures import beside, strip
from skylight.evaluation._run import Check, Item, Rows, read_index
from skylight.faces._fit import FaceFit, fit_visible
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._model import HeadModel
from skylight.faces._observe import FaceView, observe_face
from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._photo import Photo, photo_from_codes
from skylight.inverse._result import Estimate
from skylight.io._files import write_png
from skylight.sphere._frame import angle_between, angles_from_direction

OURS = DEFAULT_LIGHT
METHODS: tuple[LightName, ...] = (OURS, "autoencoder", "lamps", "auto")
INDEX = "lamps.json"
# linear; usual skin under white light, since the photographs are grey
SKIN_TINT = (1.0, 0.66, 0.51)
BY_LAMPS_DEG = 5.0  # median angle
FOUND, MEDIAN_DEG, MEAN_DEG, BIAS_DEG = 0.97, 6.0, 9.0, 2.0
TRUSTED_DEG, TRUSTED_SHARE = 10.0, 0.85
COVERED = 0.85, 0.95
POSE_SCATTER_DEG, POSE_MEDIAN_DEG, POSE_WORST_DEG = 1.5, 2.0, 8.0


@dataclass(frozen=True, kw_only=True)
class Lamps(FaceEvaluation):
    """The grey, linear photographs of ``data/lamps.json``: {file: unit vector to the lamp}.

    The vector is in the camera's frame (-Z ahead, +X right, +Y up). A file's name begins with the
    person's, up to the first ``_``; each person is taken to keep one pose, facing the camera.
    Angles are of lamps that are not behind the face (z >= 0), to the estimate's strongest lamp or
    sun, or where it has none to its brightest direction. ``every`` n-th photograph only.

    ``ablation`` adds rows with the white balance trusted (``_balanced``), with skin that varies
    over the face (``_varying_skin``), with the fitted head's normals trusted
    (``_trusted_normals``), on heads fitted to the 68 points of the mesh instead
    (``_68_points``) and, where it is installed, to dlib's (``_dlib``): six times the time.
    """

    title = "lamps"
    needs = "grey photographs of faces and a lamps.json with the direction of each one's lamp"
    data_folder = "lamps"
    quick = MappingProxyType({"every": 4})
    selects = ("every",)

    data: Path
    every: int = 1
    ablation: bool = False

    def __post_init__(self) -> None:
        lamp_index(self.data)

    def items(self) -> list[str]:
        return sorted(lamp_index(self.data))[:: self.every]

    def measure(self, item: str, picture: Path) -> Item:
        lamp = torch.tensor(lamp_index(self.data)[item], dtype=torch.float64)
        seconds: dict[str, float] = {}
        photo = read_lamp_photo(self.data / item)
        fit, view = observe_largest(photo, item, seconds)
        estimates = light_by_method(view.observation, METHODS, seconds, self.options)
        estimate = estimates[OURS]
        shown = seen_and_rendered(view, estimate.rendered)
        environments = {name: one.environment for name, one in estimates.items()}
        write_png(picture, beside(shown, strip(None, environments), item))
        facts: dict[str, object] = {
            "person": item.partition("_")[0],
            "direction": estimate.verdict.direction.word,
            "verdicts": {name: one.verdict.summary for name, one in estimates.items()},
            **choice_facts(estimates),
            "residual": estimate.faces[0].residual,
            "landmark_error": fit.landmark_error,
            "seconds": seconds,
            **pose_deg(fit),
        }
        if float(lamp[2]) < 0:
            return Item(name=item, metrics={}, facts=facts)
        if self.ablation:
            estimates |= self._ablation(photo, view)
        metrics = {
            name: lamp_errors(one.sun_direction.double(), lamp) | coverage(one.posterior, lamp)
            for name, one in estimates.items()
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def _ablation(self, photo: Photo, view: FaceView) -> dict[str, Estimate]:
        solver, weights = self.options.solver, self.options.solver.weights
        others = {
            "_balanced": replace(weights, white_balance_spread=0.0),
            "_varying_skin": replace(weights, pigment_spread=1.0),
        }
        rows = {}
        for name, other in others.items():
            options = replace(self.options, solver=replace(solver, weights=other))
            rows[OURS + name] = options.estimate(view.observation, OURS)
        trusted = replace(view.observation, normal_modes=None)
        rows[OURS + "_trusted_normals"] = self.options.estimate(trusted, OURS)
        (face, *_) = choose_landmarker().detect(photo.encoded)
        heads = {"_68_points": replace(face, readings=None)}
        if find_spec("dlib") is not None:
            for found in choose_landmarker("dlib").detect(photo.encoded)[:1]:
                heads["_dlib"] = found
        for name, head in heads.items():
            try:
                fit = fit_visible(HeadModel.load(), photo, head, name)
                seen = observe_face(photo.pixels, photo.clipped, HeadModel.load(), fit)
            except InputError:  # such a head sees no skin: the row has fewer faces
                continue
            rows[OURS + name] = self.options.estimate(seen.observation, OURS)
        return rows

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        found = float(np.mean(["no face found" not in item.problem for item in items]))
        checks = {"faces found": Check.at_least(found, FOUND)}
        ours = rows.get(OURS, {})
        if ours:
            angle = ours["angle_deg"]
            checks["median angle"] = Check.at_most(angle["median"], MEDIAN_DEG)
            checks["mean angle"] = Check.at_most(angle["mean"], MEAN_DEG)
            for what in ("elevation", "azimuth"):
                bias = abs(ours[f"{what}_deg"]["median"])
                checks[f"bias of {what}"] = Check.at_most(bias, BIAS_DEG)
            covered = ours["in_region"]["mean"]
            checks["lamp in the 90 % region"] = Check.within(covered, *COVERED)
        for name in ("lamps", "auto"):
            if name in rows:
                angle = rows[name]["angle_deg"]["median"]
                checks[f"median angle of {name}"] = Check.at_most(angle, BY_LAMPS_DEG)
        checks |= lamps_chosen(items)
        trusted = [
            item.metrics[OURS]["angle_deg"]
            for item in items
            if OURS in item.metrics and item.facts["direction"] == "sure"
        ]
        if trusted:
            share = float(np.mean(np.array(trusted) <= TRUSTED_DEG))
            name = f"of {len(trusted)} of sure direction, within {TRUSTED_DEG:g} degrees"
            checks[name] = Check.at_least(share, TRUSTED_SHARE)
        return checks | _pose_checks(items)


def _pose_checks(items: list[Item]) -> dict[str, Check]:
    """A person's pitch is the same in all photographs, and about level."""
    people: dict[object, list[float]] = {}
    for item in items:
        if "pitch_deg" in item.facts:
            pitch = float(str(item.facts["pitch_deg"]))
            people.setdefault(item.facts["person"], []).append(pitch)
    if not people:
        return {}
    medians = np.array([np.median(pitches) for pitches in people.values()])
    scatter = float(np.median([np.std(pitches) for pitches in people.values()]))
    return {
        "pitch scatters within a person by": Check.at_most(scatter, POSE_SCATTER_DEG),
        "median pitch of all people": Check.at_most(
            abs(float(np.median(medians))), POSE_MEDIAN_DEG
        ),
        "largest median pitch of a person": Check.at_most(
            float(np.abs(medians).max()), POSE_WORST_DEG
        ),
    }


def pose_deg(fit: FaceFit) -> dict[str, float]:
    """Yaw to the picture's right and pitch up of the face's forward axis."""
    x, y, z = fit.rotation[:, 2]
    return {
        "yaw_deg": math.degrees(math.atan2(x, z)),
        "pitch_deg": math.degrees(math.asin(float(np.clip(y, -1, 1)))),
    }


def lamp_errors(found: Float[Tensor, "3"], lamp: Float[Tensor, "3"]) -> dict[str, float]:
    """Angle to the lamp; azimuth and elevation found less the lamp's.

    Azimuth is to the right of the camera's back, where light from behind the camera has 0.
    """
    azimuth, zenith = angles_from_direction(torch.stack([found, lamp]))
    # the frame's azimuths grow to the right of ahead, so to the left of the back
    turn = float(azimuth[1] - azimuth[0])
    return {
        "angle_deg": math.degrees(float(angle_between(found, lamp))),
        "elevation_deg": math.degrees(float(zenith[1] - zenith[0])),
        "azimuth_deg": math.degrees(math.remainder(turn, 2 * math.pi)),
    }


def read_lamp_photo(path: Path) -> Photo:
    """A grey, linear picture as a colour photograph: tinted as skin, encoded as sRGB."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise InputError(f"{path}: missing or damaged")
    return photo_from_codes(tinted(grey))


def tinted(grey: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """sRGB codes of grey linear ones, in the hue of skin."""
    linear = torch.from_numpy(grey).float()[..., None] / 255 * torch.tensor(SKIN_TINT)
    return (255 * linear_to_srgb(linear)).round().to(torch.uint8).numpy()


@cache
def lamp_index(data: Path) -> dict[str, list[float]]:
    """Unit vectors to the lamps of a folder's photographs, in the camera's frame, by file."""
    path = data / INDEX
    index = read_index(path)
    if not isinstance(index, dict) or not index:
        raise InputError(f'{path}: expected {{"photo.png": [x, y, z], ...}}')
    for name, vector in index.items():
        if not _is_direction(vector):
            raise InputError(f"{path}: {name} needs a unit vector [x, y, z], got {vector}")
    return index


def _is_direction(vector: object) -> bool:
    if not isinstance(vector, list) or len(vector) != 3:
        return False
    if not all(isinstance(x, int | float) for x in vector):
        return False
    return abs(math.hypot(*vector) - 1) < 1e-3
