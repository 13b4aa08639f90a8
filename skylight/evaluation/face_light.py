"""Light models on one face of known light: estimates, their scores, and what they cost."""

import math
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation.known_faces import KnownFace
from skylight.evaluation.scores import score
from skylight.faces.fit import FaceFit, fit_face
from skylight.faces.landmarks import default_landmarker
from skylight.faces.model import HeadModel
from skylight.faces.observe import FaceView, observe_face
from skylight.inverse.estimate import Estimate
from skylight.inverse.photo import estimate_light
from skylight.inverse.posterior import SunPosterior
from skylight.models.shipped import LightName
from skylight.sphere.envmap import EnvironmentMap

NOT_FOUND = "no face found by the landmark detector"
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
        faces = default_landmarker().detect(face.encoded)
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
) -> LitFace:
    """Every method's light, with the head where ``fit`` says; transport is traced once.

    ``seconds`` is told what each stage took: "transport", and each method under its name.
    """
    observe = observe_face
    if face_height_px is not None:
        observe = partial(observe_face, face_height_px=face_height_px)
    with stage(seconds, "transport"):
        view = observe(face.picture, face.clipped, HeadModel.load(), fit)
    estimates, metrics = {}, {}
    for method in methods:
        cpu_start = time.process_time()
        with stage(seconds, method):
            estimates[method] = estimate_light(view.observation, method)
        metrics[method] = face_score(estimates[method].environment, face) | {
            "seconds": seconds[method],
            "cpu_seconds": time.process_time() - cpu_start,
            "transport_seconds": seconds["transport"],
        }
    return LitFace(view=view, estimates=estimates, metrics=metrics)


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
