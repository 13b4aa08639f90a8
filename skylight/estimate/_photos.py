"""Photographs in any form in, the light they were taken in out."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from skylight.estimate._pictures import STAGES, Image, Pictures
from skylight.estimate._summary import PhotoEstimate, SeenFace
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._landmarks import FaceLandmarker
from skylight.faces._names import HeadName, LandmarkerName, WhichFaces
from skylight.imaging._colour import Decode
from skylight.imaging._taken import Taken
from skylight.inverse._estimate import Model, light_problem
from skylight.inverse._result import Estimate
from skylight.inverse._sky import SOLVERS
from skylight.models._ground import KnownGround, check_has_ground
from skylight.models._names import (
    DEFAULT_LIGHT,
    DEFAULT_SOLVER,
    LightName,
    SolverName,
    check_light_name,
    check_solver_name,
)
from skylight.work._device import choose_device
from skylight.work._progress import StageProgress


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
        A picture's path, its 8-bit codes (h, w, 3), or a :class:`~skylight.imaging._photo.Photo`.
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
        Where light is traced and optimised: "cpu", "cuda", or "auto" for CUDA where it is.
    landmarks
        What finds the face: "mediapipe", "dlib" (for research only, an extra), or a
        :class:`~skylight.faces._landmarks.FaceLandmarker` of your own.
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
    are the processes that trace light on the CPU, one per core where None.

    Memory: beside 0.7 GB of a process with its models, what
    :func:`~skylight.faces._observe.observe_face` and
    :class:`~skylight.inverse._sky.SkyProblem` say of each face.
    """
    if isinstance(landmarks, str):
        landmarks = choose_landmarker(landmarks)
    check_light_name(light)
    check_has_ground(light, ground)
    options = replace(SOLVERS[check_solver_name(solver, light)], ground=ground)
    pictures = Pictures.of(
        (image, *more),
        light,
        names=names,
        decode=decode,
        taken=taken,
        ignore_exif_sun=ignore_exif_sun,
        progress=progress,
    )
    problem = light_problem(
        light,
        model=model,
        options=options,
        sun_prior=pictures.sun_prior,
        exposure=pictures.exposure,
        device=device,
    )
    fitted = pictures.fit_heads(face, head, landmarks)
    seen: list[SeenFace] = []
    observed = pictures.observe(
        fitted,
        grid_height=problem.grid_height,
        gloss=problem.uses_gloss,
        workers=workers,
        rays_on=rays_on(device),
    )
    for one in observed:
        # photographs without a usable face have no exposure to estimate
        used = sorted({face.photo for face in seen} | {one.photo})
        problem.add(one.view.observation, used.index(one.photo))
        seen.append(one if len(fitted) == 1 else one.on_fewer_rows())
    with pictures.stage(STAGES[3]) as tell:
        found = problem.solve(tell)
    return pictures.result(found, seen)


def rays_on(device: str) -> torch.device | None:
    """Where light is traced: on the GPU that is used, else by embree (None)."""
    chosen = choose_device(device)
    return None if chosen.type == "cpu" else chosen
