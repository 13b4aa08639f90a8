"""Photographs in, the light they were taken in out: the whole chain."""

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Literal

from skylight.errors import InputError
from skylight.faces.fit import FaceFit, fit_face
from skylight.faces.landmarks import DetectedFace, FaceLandmarker, choose_face, default_landmarker
from skylight.faces.model import HeadModel
from skylight.faces.observe import SKIN_GLOSS, FaceView, observe_face
from skylight.faces.skin import SkinPrior
from skylight.imaging.photo import Photo
from skylight.inverse.estimate import Estimate
from skylight.inverse.harmonic import HarmonicProblem
from skylight.inverse.solve import SkyProblem, SolverOptions
from skylight.models.autoencoder import AutoencoderLight
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
SUN_SPREAD_RAD = math.radians(1.4)  # half a pixel of the sky
KEPT_ROWS = 16  # of the transport of several faces, once the solver has taken what it needs


@dataclass(frozen=True, kw_only=True)
class SeenFace:
    """Face ``number`` (1 is the largest) of photograph ``photo``, counted from 0, named ``name``.

    Harmonics have coarser transport than skies, without gloss: a sky cannot be fitted to it.
    Where several heads were fitted, whether or not all could be used, ``view.observation`` keeps
    its transport for :data:`KEPT_ROWS` rows only.
    """

    photo: int
    number: int
    name: str
    face: DetectedFace
    fit: FaceFit
    view: FaceView


@dataclass(frozen=True, kw_only=True)
class PhotoEstimate:
    """The estimate with everything on the way to it; ``seconds`` per stage.

    ``seen`` holds the faces of ``estimate.faces``, in their order; ``face``, ``fit`` and
    ``view`` are the first one's.
    """

    estimate: Estimate
    seen: tuple[SeenFace, ...]
    seconds: dict[Stage, float] = field(default_factory=dict)

    @property
    def face(self) -> DetectedFace:
        return self.seen[0].face

    @property
    def fit(self) -> FaceFit:
        return self.seen[0].fit

    @property
    def view(self) -> FaceView:
        return self.seen[0].view


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
    """:func:`estimate_photos` of one face in one photograph."""
    return estimate_photos(
        [photo],
        light=light,
        faces=face,
        sources=[source],
        landmarker=landmarker,
        options=options,
        workers=workers,
        progress=progress,
    )


def estimate_photos(
    photos: Sequence[Photo],
    *,
    light: LightName = "autoencoder",
    faces: int | Literal["all"] = 1,
    sources: Sequence[str],
    landmarker: FaceLandmarker | None = None,
    options: SolverOptions | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> PhotoEstimate:
    """Faces, heads, transport, one light: thesis, chapter 5, with a data term for each face.

    ``faces`` is "all", or the number of one face in each photograph, counted from 1, the largest.
    ``sources`` name the pictures in errors. Cameras are taken to be level (their up is the
    world's up) and, where there are several, to look the same way. Each photograph has its own
    exposure, each face its own albedo and gloss.

    Faces turned away by more than 60 degrees, those too small to use, and photographs without
    the wanted face are left out where others remain; a line of ``estimate.advice`` names each.

    Memory: for a sky, a face on 72 rows of pixels takes about 160 MB while its light is traced
    (T and gloss of about 2,500 pixels and 8,192 directions) and 130 MB from then on, so eight
    faces fit in 2.5 GB.

    Raises
    ------
    InputError
        No face can be used, and why; an unknown light model.
    """
    check_light_name(light)
    problem = light_problem(light, options)
    seconds: dict[Stage, float] = {}
    tell = progress or (lambda stage, share: None)

    @contextmanager
    def stage(name: Stage) -> Iterator[None]:
        tell(name, 0.0)
        start = time.perf_counter()
        yield
        seconds[name] = time.perf_counter() - start
        tell(name, 1.0)

    left_out: list[str] = []
    with stage(STAGES[0]):
        detector = landmarker or default_landmarker()
        found: list[_Candidate] = []
        for number, (photo, source) in enumerate(zip(photos, sources, strict=True)):
            detected = detector.detect(photo.encoded)
            try:
                wanted = range(1, max(1, len(detected)) + 1) if faces == "all" else [faces]
                for n in wanted:
                    face = choose_face(detected, n, source)
                    name = f"{source}, face {n}" if faces == "all" else source
                    found.append(_Candidate(photo=number, number=n, name=name, face=face))
            except InputError as error:
                left_out.append(str(error))
            tell(STAGES[0], (number + 1) / len(photos))
    model = HeadModel.load()
    fitted: list[tuple[_Candidate, FaceFit]] = []
    with stage(STAGES[1]):
        for done, one in enumerate(found):
            try:
                fit = fit_visible(model, photos[one.photo], one.face, one.name)
                fitted.append((one, fit))
            except InputError as error:
                left_out.append(str(error))
            tell(STAGES[1], (done + 1) / len(found))
    seen: list[SeenFace] = []
    with stage(STAGES[2]):
        for done, (one, fit) in enumerate(fitted):

            def told(share: float, done: int = done) -> None:
                tell(STAGES[2], (done + share) / len(fitted))

            try:
                view = observe_face(
                    photos[one.photo].pixels,
                    photos[one.photo].clipped,
                    model,
                    fit,
                    grid_height=problem.grid_height,
                    specular=SKIN_GLOSS if problem.uses_gloss else None,
                    workers=workers,
                    progress=told,
                )
            except InputError as error:
                left_out.append(f"{one.name}: {error}")
                continue
            # photographs without a usable face have no exposure to estimate
            used = sorted({face.photo for face in seen} | {one.photo})
            problem.add(view.observation, used.index(one.photo))
            if len(fitted) > 1:
                view = replace(view, observation=view.observation.on_rows(KEPT_ROWS))
            seen.append(
                SeenFace(
                    photo=one.photo,
                    number=one.number,
                    name=one.name,
                    face=one.face,
                    fit=fit,
                    view=view,
                )
            )
    if not seen:
        raise InputError("; ".join(left_out))
    with stage(STAGES[3]):
        estimate = problem.solve(lambda share: tell(STAGES[3], share))
    unsure = [
        f"{one.name}: hardly a face (score {one.face.score:.2f}); check the mesh overlay"
        for one in seen
        if one.face.score < 0
    ]
    advice = (*estimate.advice, *unsure, *(f"left out: {reason}" for reason in left_out))
    # the problem counts only the photographs that it was given
    lights = tuple(
        replace(light, photo=one.photo) for light, one in zip(estimate.faces, seen, strict=True)
    )
    return PhotoEstimate(
        estimate=replace(estimate, faces=lights, advice=advice), seen=tuple(seen), seconds=seconds
    )


def fit_visible(model: HeadModel, photo: Photo, face: DetectedFace, name: str) -> FaceFit:
    """The head of a face that is turned away by no more than 60 degrees.

    Raises
    ------
    InputError
        It is turned further: most of what the light does is out of sight.
    """
    height, width = photo.encoded.shape[:2]
    fit = fit_face(model, face, width, height, focal_px=photo.focal_px)
    if fit.facing_angle_rad > MOST_TURNED_RAD:
        raise InputError(
            f"{name}: the face is turned away by {math.degrees(fit.facing_angle_rad):.0f} "
            "degrees; use a picture that shows it from the front or at most half from the side"
        )
    return fit


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    photo: int
    number: int
    name: str
    face: DetectedFace


def estimate_light(
    observation: Observation,
    light: LightName,
    options: SolverOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Light from an observation by the shipped model of that name."""
    problem = light_problem(light, options)
    problem.add(observation)
    return problem.solve(progress)


def light_problem(
    light: LightName, options: SolverOptions | None = None
) -> SkyProblem | HarmonicProblem:
    """The problem of finding light by the shipped model of that name; faces are added to it."""
    check_light_name(light)
    skin = skin_prior()
    modes = SkinPrior.load().means.float()
    if light == "autoencoder":
        return SkyProblem(smooth_autoencoder(), latent_prior(), skin, modes, options)
    if light == "sunsky":
        return SkyProblem(sunsky_light(), sunsky_prior(), skin, modes, options)
    return HarmonicProblem(HarmonicLight(2 if light == "sh9" else 4), skin, modes)


def smooth_autoencoder() -> AutoencoderLight:
    """The shipped autoencoder as faces are fitted with it: its sun moves smoothly."""
    return autoencoder_light(sun_spread_rad=SUN_SPREAD_RAD)


@cache
def skin_prior() -> GaussianMixture:
    """The mixture over log albedo in single precision."""
    return copy.deepcopy(SkinPrior.load().log_albedo).float()
