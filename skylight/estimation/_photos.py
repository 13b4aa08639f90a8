"""Photographs in any form in, the light they were taken in out.

:func:`estimate` and :func:`estimate_photo` are the doors; :class:`Pictures` holds the photographs
and does what comes before the light and after it.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Unpack

import numpy as np
import torch
from jaxtyping import UInt8

from skylight._modes import without_autocast
from skylight.errors import InputError
from skylight.estimation._settings import EstimateSettings, SettingKeywords
from skylight.estimation._summary import PhotoEstimate, SeenFace
from skylight.faces._fit import FaceFit, fit_visible
from skylight.faces._landmarks import FoundFace, find_faces
from skylight.faces._model import HeadModel
from skylight.faces._observe import SKIN_SPECULAR, observe_face
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.imaging._colour import Decode
from skylight.imaging._photo import Photo, photo_from_codes, read_photo
from skylight.inverse._own_light import follows_clock
from skylight.inverse._problem import solve
from skylight.inverse._result import Estimate
from skylight.inverse._sun_prior import SunPrior, sun_prior
from skylight.models._base import name_of
from skylight.work._progress import Progress, StageProgress
from skylight.work._threads import cores

STAGES = ("finding the face", "fitting the head", "tracing light", "estimating the light")
# Landmarks farther off the fitted head, of the distance of the eyes as seen, are no face's: of 62
# photographs, 191 faces under lamps and 150 rendered people they are up to 0.05, 0.04 and 0.08 off.
NO_HEAD = 0.09
Image = str | Path | Photo | UInt8[np.ndarray, "h w 3"]


def estimate(
    image: Image,
    *more: Image,
    taken: CaptureMetadata | None = None,
    progress: StageProgress | None = None,
    **settings: Unpack[SettingKeywords],
) -> Estimate:
    """The light in which a face was photographed, or several.

    Faces, heads, transport, one light: thesis, chapter 5, with a data term for each face. Cameras
    are taken to be level (their up is the world's up) and, where there are several, to look the
    same way. Each photograph has its own exposure, each face its own albedo and specular scale.

    Parameters
    ----------
    image, more
        A picture's path, its 8-bit codes (h, w, 3), or a :class:`~skylight.imaging._photo.Photo`.
        Several pictures share their light.
    taken
        When and where the first picture was taken, and where its camera looked: what they tell
        of the sun counts. They overrule what its EXIF data say.
    progress
        Called with the name of a stage and the share of it that is done.
    settings
        ``light=``, ``prior=``, ``model=``, ``solver=``, ``face=``, ``head=``, ``decode=``,
        ``landmarks=``, ``ignore_exif_sun=``, ``ground=``, ``place=``, ``detail=`` and
        ``device=``, those of
        :class:`~skylight.estimation._settings.EstimateSettings`.

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
    return estimate_photo(image, *more, taken=taken, progress=progress, **settings).estimate


@without_autocast
def estimate_photo(
    image: Image,
    *more: Image,
    taken: CaptureMetadata | None = None,
    names: Sequence[str] | None = None,
    workers: int | None = None,
    progress: StageProgress | None = None,
    **settings: Unpack[SettingKeywords],
) -> PhotoEstimate:
    """:func:`estimate` with everything on the way: faces, heads, pixels, seconds.

    ``names`` are what errors and results call the pictures; by default their paths. ``workers``
    are the processes that trace light on the CPU, one per core where None.

    Memory: beside 0.7 GB of a process with its models, what
    :func:`~skylight.faces._observe.observe_face` and
    :class:`~skylight.inverse._sky.SkyProblem` say of each face.
    """
    chosen = EstimateSettings(**settings)
    pictures = Pictures.of(
        (image, *more), chosen, taken=taken, names=names, workers=workers, progress=progress
    )
    return pictures.estimate()


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """Photographs with one light, their ``files`` where there are, and what is known beforehand.

    ``workers`` are the processes that trace light on the CPU, one per core where None. ``taken`` is
    the first one's time, place and heading, ``sun_prior`` what these tell, ``notes`` what to know
    of them. ``left_out`` grows by a line for each face and photograph that cannot be
    used, ``seconds`` by the stages that are done.
    """

    settings: EstimateSettings
    photos: tuple[Photo, ...]
    names: tuple[str, ...]
    files: tuple[Path | None, ...]
    taken: CaptureMetadata
    sun_prior: SunPrior | None
    notes: tuple[str, ...]
    workers: int | None = None
    left_out: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    progress: StageProgress | None = None

    @staticmethod
    def of(
        images: Sequence[Image],
        settings: EstimateSettings,
        *,
        taken: CaptureMetadata | None = None,
        names: Sequence[str] | None = None,
        workers: int | None = None,
        progress: StageProgress | None = None,
    ) -> "Pictures":
        """Read where they are files; the parameters are those of :func:`estimate_photo`."""
        photos = tuple(_as_photo(one, settings.decode) for one in images)
        names = tuple(names or (_name(one, k, len(images)) for k, one in enumerate(images, 1)))
        known = _known_of(photos[0], taken, ignore_exif_sun=settings.ignore_exif_sun)
        prior, of_sun = sun_prior(known)
        if prior is not None and not follows_clock(settings.light, settings.prior, settings.place):
            name = name_of(settings.light)
            told = name if settings.place == "auto" else f"{name}, {settings.place}"
            prior, of_sun = None, (f"{told}: no light by the clock, time and place were not used",)
        notes = (*(f"{names[0]}: {note}" for note in known.notes), *of_sun, *_unused(taken, known))
        return Pictures(
            settings=settings,
            photos=photos,
            names=names,
            files=tuple(Path(one) if isinstance(one, str | Path) else None for one in images),
            taken=known,
            sun_prior=prior,
            notes=notes,
            workers=workers,
            progress=progress,
        )

    @property
    def exposure(self) -> float | None:
        """The first photograph's exposure value."""
        return self.photos[0].exposure_value

    def estimate(self) -> PhotoEstimate:
        """The light, found in this process; of several faces one at a time is held in full.

        Raises
        ------
        InputError
            As :func:`estimate`.
        """
        (problem,) = self.settings.problems([self.sun_prior], [self.exposure])
        fitted = self.fit_heads()
        seen: list[SeenFace] = []
        for one in self.observe(
            fitted,
            problem.grid_height,
            problem.uses_specular,
            self.settings.rays_on,
            background=problem.uses_background,
        ):
            # photographs without a usable face have no exposure to estimate
            used = sorted({face.photo for face in seen} | {one.photo})
            problem.add(one.view.observation, used.index(one.photo))
            seen.append(one if len(fitted) == 1 else one.on_fewer_rows())
        with self.stage(STAGES[3]) as tell:
            (found,) = solve([problem], tell)
        return self.result(found, seen)

    def fit_heads(self) -> list[tuple[FoundFace, FaceFit]]:
        """The heads of the faces that can be used."""
        settings, landmarker = self.settings, self.settings.landmarker
        with self.stage(STAGES[0]) as tell:
            found, missing = find_faces(self.photos, self.names, settings.face, landmarker, tell)
        self.left_out.extend(missing)
        fitted: list[tuple[FoundFace, FaceFit]] = []
        heads = HeadModel.load()
        with self.stage(STAGES[1]) as tell:
            for done, one in enumerate(found, start=1):
                photo = self.photos[one.photo]
                try:
                    fit = fit_visible(heads, photo, one.face, one.name, settings.head)
                    fitted.append((one, fit))
                except InputError as error:
                    self.left_out.append(str(error))
                tell(done / len(found))
        return fitted

    def observe(
        self,
        fitted: Sequence[tuple[FoundFace, FaceFit]],
        grid_height: int,
        specular: bool,
        rays_on: torch.device | None = None,
        *,
        background: bool = False,
    ) -> Iterator[SeenFace]:
        """Each face with its transport on so many rows; ``specular`` adds that of the skin's lobe.

        ``rays_on`` is that of :func:`~skylight.faces._observe.observe_face`. With ``background``,
        each photograph's goes with the first of its faces; where it is shown in the map, its pixels
        do in any case.
        """
        heads, seen = HeadModel.load(), set[int]()
        shown = self.settings.detail != "none"
        with self.stage(STAGES[2]) as tell:
            for done, (one, fit) in enumerate(fitted):

                def told(share: float, done: int = done) -> None:
                    tell((done + share) / len(fitted))

                photo = self.photos[one.photo]
                beside = None
                if (background or shown) and one.photo not in seen:
                    others = (each for each in fitted if each[0].photo == one.photo)
                    beside = [other for _, other in others if other is not fit]
                try:
                    view = observe_face(
                        photo.pixels,
                        photo.clipped,
                        heads,
                        fit,
                        grid_height=grid_height,
                        specular=SKIN_SPECULAR if specular else None,
                        grey=photo.grey,
                        beside=beside,
                        workers=self.workers or cores(),
                        rays_on=rays_on,
                        progress=told,
                    )
                except InputError as error:
                    self.left_out.append(f"{one.name}: {error}")
                    continue
                if not background:
                    observation = replace(view.observation, background=None)
                    view = replace(view, observation=observation, no_background=None)
                seen.add(one.photo)
                yield SeenFace(**vars(one), fit=fit, view=view)
        if not seen:
            raise InputError("; ".join(self.left_out))

    def result(self, light: Estimate, seen: Sequence[SeenFace]) -> PhotoEstimate:
        """The estimate from the faces ``seen``, with all that is to know of it."""
        unsure = [
            f"{one.name}: hardly a face (score {one.face.score:.2f}); check the mesh overlay"
            for one in seen
            if one.face.score < 0
        ]
        unsure += [
            f"{one.name}: the background was not used: {one.view.no_background}"
            for one in seen
            if one.view.no_background is not None
        ]
        no_heads = [one for one in seen if one.fit.landmark_error > NO_HEAD]
        for one in no_heads:
            off = f"{100 * one.fit.landmark_error:.0f} % of the eyes' distance"
            unsure.append(
                f"{one.name}: hardly a face (landmarks are {off} off the head); check the mesh "
                "overlay"
            )
        if len(no_heads) == len(seen):
            light = replace(light, doubt="hardly a face")
        advice = (
            *light.advice,
            *unsure,
            *_advice_of_photos(self.photos, self.names, {face.photo for face in seen}),
            *self.notes,
            *(f"left out: {reason}" for reason in self.left_out),
        )
        # the problem counts only the photographs that it was given
        faces = tuple(
            replace(face, photo=one.photo) for face, one in zip(light.faces, seen, strict=True)
        )
        return PhotoEstimate(
            estimate=replace(light, faces=faces, advice=advice),
            photos=self.photos,
            names=self.names,
            seen=tuple(seen),
            taken=self.taken,
            seconds=self.seconds,
            detail=self.settings.detail,
            files=self.files,
            decode=self.settings.decode,
        )

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Tells ``progress`` of a stage, and ``seconds`` how long it took."""
        tell = self.progress or (lambda _stage, _share: None)
        tell(name, 0.0)
        start = time.perf_counter()
        yield lambda share: tell(name, share)
        self.seconds[name] = time.perf_counter() - start
        tell(name, 1.0)


def _as_photo(image: Image, decode: Decode | None) -> Photo:
    """The picture that a path, 8-bit codes or a photo is."""
    if isinstance(image, str | Path):
        return read_photo(image, decode=decode)
    if isinstance(image, np.ndarray):
        return photo_from_codes(image, decode=decode)
    if decode is not None:
        raise InputError("decode is for files and 8-bit codes: a Photo is decoded already")
    return image


def _known_of(
    photo: Photo, by_hand: CaptureMetadata | None, *, ignore_exif_sun: bool
) -> CaptureMetadata:
    """Time, place and heading of a photograph: by hand, else from its EXIF data."""
    recorded = CaptureMetadata() if ignore_exif_sun or photo.taken is None else photo.taken
    return recorded if by_hand is None else recorded.overruled_by(by_hand)


def _unused(by_hand: CaptureMetadata | None, known: CaptureMetadata) -> Iterator[str]:
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
