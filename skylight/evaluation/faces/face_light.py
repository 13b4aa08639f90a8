"""Light models estimated from one face under known illumination: scores and cost."""

import math
import resource
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation.faces.known_faces import KnownFace
from skylight.evaluation.faces.options import EstimateOptions
from skylight.evaluation.harness.run import Check, Item
from skylight.evaluation.scores.relit_scene import score
from skylight.faces.detection.landmarkers import choose_landmarker
from skylight.faces.fit import FaceFit, fit_face
from skylight.faces.landmarks import choose_face
from skylight.faces.model import HeadModel
from skylight.faces.observe import FaceView, observe_face
from skylight.faces.photographs import fit_visible
from skylight.imaging.colour import tone_map
from skylight.imaging.photo import Photo
from skylight.inverse.auto import RIVALS, choose
from skylight.inverse.posterior import SunPosterior
from skylight.inverse.result import Estimate
from skylight.models.names import LightName
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.transport.observation import Observation

NOT_FOUND = "no face found by the landmark detector"
CHOSEN = 0.9  # of rooms and lamps, by "auto"
METHODS: tuple[LightName, ...] = ("sh9", "sh25", "sunsky", "autoencoder")


@dataclass(frozen=True, kw_only=True)
class LitFace:
    """Estimates by method, all from one ``view``, and their metrics."""

    view: FaceView
    estimates: dict[str, Estimate]
    metrics: dict[str, dict[str, float]]


def fitted_head(face: KnownFace, seconds: dict[str, float]) -> FaceFit | None:
    """The head as a photograph's would be fitted; None where the landmark detector finds none.

    ``seconds`` is told what each stage took: "landmarks" and "head".
    """
    height, width = face.encoded.shape[:2]
    with stage(seconds, "landmarks"):
        faces = choose_landmarker().detect(face.encoded)
    if not faces:
        return None
    with stage(seconds, "head"):
        return fit_face(HeadModel.load(), faces[0], width, height)


def light_of(
    face: KnownFace,
    fit: FaceFit,
    methods: tuple[LightName, ...],
    seconds: dict[str, float],
    *,
    face_height_px: int | None = None,
    options: EstimateOptions = EstimateOptions(),
) -> LitFace:
    """Every method's light, with the head where ``fit`` says; transport is traced once.

    ``seconds`` is told what each stage took: "transport", and each method under its name.
    """
    observe = observe_face
    if face_height_px is not None:
        observe = partial(observe_face, face_height_px=face_height_px)
    with stage(seconds, "transport"):
        view = observe(face.picture, face.clipped, HeadModel.load(), fit)
    cpu_seconds: dict[str, float] = {}
    estimates = light_by_method(view.observation, methods, seconds, options, cpu_seconds)
    metrics = {
        method: face_score(estimate.environment, face)
        | {
            "seconds": seconds[method],
            "cpu_seconds": cpu_seconds[method],
            "transport_seconds": seconds["transport"],
        }
        for method, estimate in estimates.items()
    }
    return LitFace(view=view, estimates=estimates, metrics=metrics)


def light_by_method(
    observation: Observation,
    methods: Sequence[LightName],
    seconds: dict[str, float],
    options: EstimateOptions,
    cpu_seconds: dict[str, float] | None = None,
) -> dict[str, Estimate]:
    """The light of a face by every method; ``seconds`` are told what each took, under its name.

    "auto" chooses from those of :data:`~skylight.inverse.auto.RIVALS`, which come before it.
    """
    cpu_seconds = {} if cpu_seconds is None else cpu_seconds
    if "auto" in methods:
        options = options.with_evidence()
    estimates: dict[str, Estimate] = {}
    for method in methods:
        if method == "auto":  # which takes what its rivals take
            if not {*RIVALS} <= {*estimates}:
                raise InputError(f"auto chooses from {' and '.join(RIVALS)}: name them first")
            estimates[method] = choose([estimates[rival] for rival in RIVALS])
            for told in (seconds, cpu_seconds):
                told[method] = sum(told[rival] for rival in RIVALS)
            continue
        cpu_start = time.process_time()
        with stage(seconds, method):
            estimates[method] = options.estimate(observation, method)
        cpu_seconds[method] = time.process_time() - cpu_start
    return estimates


def choice_facts(estimates: Mapping[str, Any]) -> dict[str, object]:
    """What "auto" chose, and the evidence of every model; nothing where it was not asked."""
    if "auto" not in estimates:
        return {}
    return {
        "chosen": estimates["auto"].light,
        "evidence": {name: one.log_evidence for name, one in estimates.items()},
    }


def lamps_chosen(items: list[Item]) -> dict[str, Check]:
    """For which part of the items "auto" chose lamps; none where it was not asked."""
    chosen = [item.facts["chosen"] == "lamps" for item in items if "chosen" in item.facts]
    if not chosen:
        return {}
    share = float(np.mean(chosen))
    return {"faces for which lamps are chosen": Check.at_least(share, CHOSEN)}


def observe_largest(
    photo: Photo, name: str, seconds: dict[str, float] | None = None
) -> tuple[FaceFit, FaceView]:
    """Head and pixels of a photograph's largest face, as an estimate sees them.

    Raises
    ------
    InputError
        There is no face that can be used.
    """
    seconds = {} if seconds is None else seconds
    model = HeadModel.load()
    with stage(seconds, "landmarks"):
        face = choose_face(choose_landmarker().detect(photo.encoded), 1, name)
    with stage(seconds, "head"):
        fit = fit_visible(model, photo, face, name)
    with stage(seconds, "transport"):
        return fit, observe_face(photo.pixels, photo.clipped, model, fit)


def seen_and_rendered(view: FaceView, rendered: Float[Tensor, "m 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture, and beside it the face as the estimate renders it."""
    shown = view.image.clone()
    rows, columns = view.places.unbind(1)
    shown[rows, columns] = rendered[view.blocks]
    white = float(luminance(view.image[rows, columns]).quantile(0.98))
    return np.hstack([tone_map(picture, white=white) for picture in (view.image, shown)])


def coverage(posterior: SunPosterior, sun: Float[Tensor, "3"]) -> dict[str, float]:
    """``in_region``: 1 where the 90 % region holds the true sun's cell; ``region_sr``: its size."""
    directions = posterior.grid.directions
    cell = int((directions @ sun.to(directions)).argmax())
    return {
        "in_region": float(bool(posterior.region[cell])),
        "region_sr": posterior.region_sr,
    }


def face_score(found: EnvironmentMap, face: KnownFace) -> dict[str, float]:
    return score(found, face.environment, sun_visible=face.sun_visible)


@contextmanager
def stage(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Adds the seconds that the block took to those noted under ``name``."""
    start = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start


def peak_mib() -> float:
    """Most memory that this process has held so far, MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def pose_error_deg(fit: FaceFit, truth: FaceFit) -> float:
    """Angle of the rotation R_fit^T R_true."""
    cosine = (np.trace(fit.rotation.T @ truth.rotation) - 1) / 2
    return math.degrees(math.acos(float(np.clip(cosine, -1, 1))))
