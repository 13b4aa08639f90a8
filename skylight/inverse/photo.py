"""One photograph in, the light it was taken in out: the whole chain."""

import copy
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache

from skylight.errors import InputError
from skylight.faces.fit import FaceFit, fit_face
from skylight.faces.landmarks import DetectedFace, FaceLandmarker, choose_face, default_landmarker
from skylight.faces.model import HeadModel
from skylight.faces.observe import FaceView, observe_face
from skylight.faces.skin import SkinPrior
from skylight.imaging.photo import Photo
from skylight.inverse.solve import Estimate, SolverOptions, solve_harmonic, solve_sky
from skylight.models.harmonic import HarmonicLight
from skylight.models.prior import GaussianMixture
from skylight.models.shipped import (
    LightName,
    autoencoder_light,
    check_light_name,
    latent_prior,
    sunsky_light,
    sunsky_prior,
)
from skylight.transport.observation import Observation

Stage = str
Progress = Callable[[Stage, float], None]
STAGES = ("finding the face", "fitting the head", "tracing light", "estimating the light")
MOST_TURNED_RAD = math.radians(60)


@dataclass(frozen=True, kw_only=True)
class PhotoEstimate:
    """The estimate with everything on the way to it; ``seconds`` per stage."""

    estimate: Estimate
    face: DetectedFace
    fit: FaceFit
    view: FaceView
    seconds: dict[Stage, float] = field(default_factory=dict)


def estimate_photo(
    photo: Photo,
    *,
    light: LightName = "autoencoder",
    face: int = 1,
    source: str = "the picture",
    landmarker: FaceLandmarker | None = None,
    options: SolverOptions | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> PhotoEstimate:
    """Face, head, transport, light: thesis, chapter 5.

    ``face`` counts from 1, the largest. ``source`` names the picture in errors. The camera is
    taken to be level: its up is the world's up.

    Raises
    ------
    InputError
        No such face, a face turned away by more than 60 degrees, too few usable pixels, an
        unknown light model.
    """
    check_light_name(light)
    seconds: dict[Stage, float] = {}
    tell = progress or (lambda stage, share: None)

    @contextmanager
    def stage(name: Stage) -> Iterator[None]:
        tell(name, 0.0)
        start = time.perf_counter()
        yield
        seconds[name] = time.perf_counter() - start
        tell(name, 1.0)

    model = HeadModel.load()
    height, width = photo.encoded.shape[:2]
    with stage(STAGES[0]):
        faces = (landmarker or default_landmarker()).detect(photo.encoded)
        detected = choose_face(faces, face, source)
    with stage(STAGES[1]):
        fit = fit_face(model, detected, width, height, focal_px=photo.focal_px)
    if fit.facing_angle_rad > MOST_TURNED_RAD:
        raise InputError(
            f"{source}: the face is turned away by {math.degrees(fit.facing_angle_rad):.0f} "
            "degrees; use a picture that shows it from the front or at most half from the side"
        )
    with stage(STAGES[2]):
        view = observe_face(
            photo.pixels,
            photo.clipped,
            model,
            fit,
            workers=workers,
            progress=lambda share: tell(STAGES[2], share),
        )
    with stage(STAGES[3]):
        estimate = estimate_light(
            view.observation, light, options, lambda share: tell(STAGES[3], share)
        )
    return PhotoEstimate(estimate=estimate, face=detected, fit=fit, view=view, seconds=seconds)


def estimate_light(
    observation: Observation,
    light: LightName,
    options: SolverOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Light from an observation by the shipped model of that name."""
    check_light_name(light)
    skin = _skin_prior()
    modes = SkinPrior.load().means.float()
    if light == "autoencoder":
        return solve_sky(
            observation, autoencoder_light(), latent_prior(), skin, modes, options, progress
        )
    if light == "sunsky":
        return solve_sky(
            observation, sunsky_light(), sunsky_prior(), skin, modes, options, progress
        )
    return solve_harmonic(observation, HarmonicLight(2 if light == "sh9" else 4), skin, modes)


@cache
def _skin_prior() -> GaussianMixture:
    """The mixture over log albedo in single precision."""
    return copy.deepcopy(SkinPrior.load().log_albedo).float()
