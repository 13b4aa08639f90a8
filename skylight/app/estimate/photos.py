"""Photographs in any form in, the light they were taken in out."""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from skylight.app.estimate.types import PhotoEstimate, SeenFace
from skylight.errors import InputError
from skylight.faces.detection.landmarkers import choose_landmarker
from skylight.faces.fit import FaceFit
from skylight.faces.landmarks import FaceLandmarker
from skylight.faces.model import HeadModel
from skylight.faces.names import HeadName, LandmarkerName, WhichFaces
from skylight.faces.observe import SKIN_GLOSS, observe_face
from skylight.faces.photographs import FoundFace, find_faces, fit_visible
from skylight.imaging.colour import Decode
from skylight.imaging.photo import Photo, photo_from_codes, read_photo
from skylight.imaging.taken import Taken
from skylight.inverse.estimate import Model, light_problem
from skylight.inverse.result import Estimate
from skylight.inverse.scan import SCAN_HEIGHT
from skylight.inverse.sky.solver import SOLVERS
from skylight.inverse.sun_prior import sun_prior
from skylight.models.known_ground import KnownGround, check_has_ground
from skylight.models.names import (
    DEFAULT_LIGHT,
    DEFAULT_SOLVER,
    LightName,
    SolverName,
    check_light_name,
    check_solver_name,
)
from skylight.work.progress import Progress, StageProgress

STAGES = ("finding the face", "fitting the head", "tracing light", "estimating the light")
# Of the transport of several faces, once the solver has taken what it needs: as many as lamps are
# found on, so that the faces can be seen under other ones.
KEPT_ROWS = SCAN_HEIGHT
# Landmarks farther off the fitted head, of the distance of the eyes as seen, are no face's: of 62
# photographs, 191 faces under lamps and 150 rendered people they are up to 0.05, 0.04 and 0.08 off.
NO_HEAD = 0.09
Image = str | Path | Photo | UInt8[np.ndarray, "h w 3"]


def estimate(
    image: Image,
    *more: Image,
    light: LightName = DEFAULT_LIGHT,
    model: Model | None = None,
    solver: SolverName = DEFAULT_SOLVER,
    face: WhichFaces = 1,
    head: HeadName = "fitted",
    decode: Decode | None = None,
    device: str = "auto",
    landmarks: LandmarkerName | FaceLandmarker = "mediapipe",
    taken: Taken | None = None,
    ignore_exif_sun: bool = False,
    ground: KnownGround | None = None,
    progress: StageProgress | None = None,
) -> Estimate:
    """The light in which a face was photographed, or several.

    Faces, heads, transport, one light: thesis, chapter 5, with a data term for each face. Cameras
    are taken to be level (their up is the world's up) and, where there are several, to look the
    same way. Each photograph has its own exposure, each face its own albedo and gloss.

    Parameters
    ----------
    image, more
        A picture's path, its 8-bit codes (h, w, 3), or a :class:`~skylight.imaging.photo.Photo`.
        Several pictures share their light.
    light
        The light model: "auto" (the likelier of "autoencoder" and "lamps"), "autoencoder" (learnt
        skies), "sunsky" (Preetham's sky and a sun), "lamps" (up to three in ambient light), "sh9"
        or "sh25" (spherical harmonics up to degree 2 or 4).
    model
        A trained model of your own, or its folder, in place of the one that comes with skylight:
        the network of "autoencoder", or the prior of "sunsky". ``skylight train`` makes them.
    solver
        How the sky of "autoencoder" is searched for: "scan", from many starts where a scan finds
        the sun, or "thesis", from the mean sky by L-BFGS on four levels (B.1).
    face
        Which face of each picture, counted from 1, the largest; or "all", under one light.
    head
        "fitted": the morphable model's head. "deformed": that head bent by bounded biharmonic
        weights until its inner landmarks are where they were detected, as in the thesis; better
        only with landmarks that are exact to a millimetre.
    decode
        How values encode light: "srgb", "linear" or the exponent of a power law; None for what
        the file says. Not for a ``Photo``, which is decoded already.
    device
        Where the light is optimised: "cpu", "cuda", or "auto" for CUDA where it is.
    landmarks
        What finds the face: "mediapipe", "dlib" (for research only, an extra), or a
        :class:`~skylight.faces.landmarks.FaceLandmarker` of your own.
    taken
        When and where the first picture was taken, and where its camera looked: what they tell
        of the sun counts. They overrule what its EXIF data say.
    ignore_exif_sun
        Leave the time, place and heading of its EXIF data unused. Its focal length counts all the
        same, and for "auto" the exposure of the first picture.
    ground
        The albedo of the ground where it is known, for skies over a ground ("auto",
        "autoencoder", "sunsky"); by default what is usual.
    progress
        Called with the name of a stage and the share of it that is done.

    Returns
    -------
    Estimate
        ``environment`` is the light as a full map in the camera's frame: its centre is where
        the camera looks (-Z), +X is the picture's right, +Y up.

    Raises
    ------
    InputError
        No face can be used; the message says why and what to do. Faces turned away by more than
        60 degrees, those too small, and photographs without the wanted face are left out where
        others remain; a line of ``advice`` names each.
    """
    return estimate_photo(
        image,
        *more,
        light=light,
        model=model,
        solver=solver,
        face=face,
        head=head,
        decode=decode,
        device=device,
        landmarks=landmarks,
        taken=taken,
        ignore_exif_sun=ignore_exif_sun,
        ground=ground,
        progress=progress,
    ).estimate


def estimate_photo(
    image: Image,
    *more: Image,
    light: LightName = DEFAULT_LIGHT,
    model: Model | None = None,
    solver: SolverName = DEFAULT_SOLVER,
    face: WhichFaces = 1,
    head: HeadName = "fitted",
    decode: Decode | None = None,
    device: str = "auto",
    landmarks: LandmarkerName | FaceLandmarker = "mediapipe",
    taken: Taken | None = None,
    ignore_exif_sun: bool = False,
    ground: KnownGround | None = None,
    names: Sequence[str] | None = None,
    workers: int | None = None,
    progress: StageProgress | None = None,
) -> PhotoEstimate:
    """:func:`estimate` with everything on the way: faces, heads, pixels, seconds.

    ``names`` are what errors and results call the pictures; by default their paths. ``workers``
    are the processes that trace light, one per core where None.

    Memory: beside 0.7 GB of a process with its models, what
    :func:`~skylight.faces.observe.observe_face` and
    :class:`~skylight.inverse.sky.problem.SkyProblem` say of each face.
    """
    if isinstance(landmarks, str):
        landmarks = choose_landmarker(landmarks)
    check_light_name(light)
    check_has_ground(light, ground)
    options = replace(SOLVERS[check_solver_name(solver, light)], ground=ground)
    images = (image, *more)
    photos = tuple(as_photo(one, decode) for one in images)
    names = tuple(names or (_name(one, k, len(images)) for k, one in enumerate(images, start=1)))
    known = _known_of(photos[0], taken, ignore_exif_sun=ignore_exif_sun)
    prior, of_sun = sun_prior(known)
    if prior is not None and light == "lamps":
        prior, of_sun = None, ("lamps do not follow the clock: time and place were not used",)
    problem = light_problem(
        light,
        model=model,
        options=options,
        sun_prior=prior,
        exposure=photos[0].exposure_value,
        device=device,
    )
    seconds: dict[str, float] = {}
    heads = HeadModel.load()
    with _stage(STAGES[0], seconds, progress) as tell:
        found, left_out = find_faces(photos, names, face, landmarks, tell)
    fitted: list[tuple[FoundFace, FaceFit]] = []
    with _stage(STAGES[1], seconds, progress) as tell:
        for done, one in enumerate(found, start=1):
            try:
                fit = fit_visible(heads, photos[one.photo], one.face, one.name, head)
                fitted.append((one, fit))
            except InputError as error:
                left_out.append(str(error))
            tell(done / len(found))
    seen: list[SeenFace] = []
    with _stage(STAGES[2], seconds, progress) as tell:
        for done, (one, fit) in enumerate(fitted):

            def told(share: float, done: int = done) -> None:
                tell((done + share) / len(fitted))

            try:
                view = observe_face(
                    photos[one.photo].pixels,
                    photos[one.photo].clipped,
                    heads,
                    fit,
                    grid_height=problem.grid_height,
                    specular=SKIN_GLOSS if problem.uses_gloss else None,
                    grey=photos[one.photo].grey,
                    workers=workers or os.cpu_count() or 1,
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
    with _stage(STAGES[3], seconds, progress) as tell:
        found_light = problem.solve(tell)
    unsure = [
        f"{one.name}: hardly a face (score {one.face.score:.2f}); check the mesh overlay"
        for one in seen
        if one.face.score < 0
    ]
    no_heads = [one for one in seen if one.fit.landmark_error > NO_HEAD]
    for one in no_heads:
        off = f"{100 * one.fit.landmark_error:.0f} % of the eyes' distance"
        unsure.append(
            f"{one.name}: hardly a face (landmarks are {off} off the head); check the mesh overlay"
        )
    if len(no_heads) == len(seen):
        posterior = replace(found_light.posterior, verdict="unreliable: hardly a face")
        found_light = replace(found_light, posterior=posterior)
    advice = (
        *found_light.advice,
        *unsure,
        *_advice_of_photos(photos, names, {face.photo for face in seen}),
        *(f"{names[0]}: {note}" for note in known.notes),
        *of_sun,
        *_unused(taken, known),
        *(f"left out: {reason}" for reason in left_out),
    )
    # the problem counts only the photographs that it was given
    lights = tuple(
        replace(light, photo=one.photo) for light, one in zip(found_light.faces, seen, strict=True)
    )
    return PhotoEstimate(
        estimate=replace(found_light, faces=lights, advice=advice),
        photos=photos,
        names=names,
        seen=tuple(seen),
        taken=known,
        seconds=seconds,
    )


def as_photo(image: Image, decode: Decode | None) -> Photo:
    """The picture that a path, 8-bit codes or a photo is."""
    if isinstance(image, str | Path):
        return read_photo(image, decode=decode)
    if isinstance(image, np.ndarray):
        return photo_from_codes(image, decode=decode)
    if decode is not None:
        raise InputError("decode is for files and 8-bit codes: a Photo is decoded already")
    return image


def _known_of(photo: Photo, by_hand: Taken | None, *, ignore_exif_sun: bool) -> Taken:
    """Time, place and heading of a photograph: by hand, else from its EXIF data."""
    recorded = Taken() if ignore_exif_sun or photo.taken is None else photo.taken
    return recorded if by_hand is None else recorded.overruled_by(by_hand)


def _unused(by_hand: Taken | None, known: Taken) -> Iterator[str]:
    """Only time and place together tell of the sun; that EXIF data have but one is no news."""
    for name, value in (("time", known.time), ("place", known.latitude_deg)):
        if by_hand is not None and value is None:
            yield f"without the picture's {name}, what was given tells nothing of the sun"


def _advice_of_photos(
    photos: Sequence[Photo], names: Sequence[str], used: set[int]
) -> Iterator[str]:
    """What to know of the light in the photographs that were used."""
    for number in sorted(used):
        photo = photos[number]
        of = f"{names[number]}: " if len(photos) > 1 else ""
        if photo.grey:
            yield f"{of}grey picture: the colour of the light is the priors'"
        if photo.flash:
            yield f"{of}the flash fired: part of the light comes from the camera"


def _name(image: Image, number: int, count: int) -> str:
    if isinstance(image, str | Path):
        return str(image)
    return "the picture" if count == 1 else f"picture {number}"


@contextmanager
def _stage(
    name: str, seconds: dict[str, float], progress: StageProgress | None
) -> Iterator[Progress]:
    """Tells ``progress`` of a stage, and ``seconds`` how long it took."""
    tell = progress or (lambda _stage, _share: None)
    tell(name, 0.0)
    start = time.perf_counter()
    yield lambda share: tell(name, share)
    seconds[name] = time.perf_counter() - start
    tell(name, 1.0)
