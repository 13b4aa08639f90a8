"""Pictures in any form, the faces that are seen in them, and what their light is told with."""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8

from skylight.errors import InputError
from skylight.estimate._summary import PhotoEstimate, SeenFace
from skylight.faces._fit import FaceFit, fit_visible
from skylight.faces._landmarks import FaceLandmarker, FoundFace, find_faces
from skylight.faces._model import HeadModel
from skylight.faces._names import HeadName, WhichFaces
from skylight.faces._observe import SKIN_GLOSS, observe_face
from skylight.imaging._colour import Decode
from skylight.imaging._photo import Photo, photo_from_codes, read_photo
from skylight.imaging._taken import Taken
from skylight.inverse._result import Estimate
from skylight.inverse._sun_prior import SunPrior, sun_prior
from skylight.models._names import LightName
from skylight.work._progress import Progress, StageProgress

STAGES = ("finding the face", "fitting the head", "tracing light", "estimating the light")
# Landmarks farther off the fitted head, of the distance of the eyes as seen, are no face's: of 62
# photographs, 191 faces under lamps and 150 rendered people they are up to 0.05, 0.04 and 0.08 off.
NO_HEAD = 0.09
Image = str | Path | Photo | UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """Photographs with one light, and what is known of it beforehand.

    ``taken`` is the first one's time, place and heading, ``sun_prior`` what these tell, ``notes``
    what to know of them. ``left_out`` grows by a line for each face and photograph that cannot be
    used, ``seconds`` by the stages that are done.
    """

    photos: tuple[Photo, ...]
    names: tuple[str, ...]
    taken: Taken
    sun_prior: SunPrior | None
    notes: tuple[str, ...]
    left_out: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    progress: StageProgress | None = None

    @staticmethod
    def of(
        images: Sequence[Image],
        light: LightName,
        *,
        names: Sequence[str] | None = None,
        decode: Decode | None = None,
        taken: Taken | None = None,
        ignore_exif_sun: bool = False,
        progress: StageProgress | None = None,
    ) -> "Pictures":
        """Read where they are files; the parameters are those of
        :func:`~skylight.estimate._photos.estimate_photo`."""
        photos = tuple(_as_photo(one, decode) for one in images)
        names = tuple(names or (_name(one, k, len(images)) for k, one in enumerate(images, 1)))
        known = _known_of(photos[0], taken, ignore_exif_sun=ignore_exif_sun)
        prior, of_sun = sun_prior(known)
        if prior is not None and light == "lamps":
            prior, of_sun = None, ("lamps do not follow the clock: time and place were not used",)
        notes = (*(f"{names[0]}: {note}" for note in known.notes), *of_sun, *_unused(taken, known))
        return Pictures(
            photos=photos,
            names=names,
            taken=known,
            sun_prior=prior,
            notes=notes,
            progress=progress,
        )

    @property
    def exposure(self) -> float | None:
        """The first photograph's exposure value."""
        return self.photos[0].exposure_value

    def fit_heads(
        self, which: WhichFaces, head: HeadName, landmarks: FaceLandmarker
    ) -> list[tuple[FoundFace, FaceFit]]:
        """The heads of the faces that can be used."""
        with self.stage(STAGES[0]) as tell:
            found, missing = find_faces(self.photos, self.names, which, landmarks, tell)
        self.left_out.extend(missing)
        fitted: list[tuple[FoundFace, FaceFit]] = []
        heads = HeadModel.load()
        with self.stage(STAGES[1]) as tell:
            for done, one in enumerate(found, start=1):
                try:
                    fit = fit_visible(heads, self.photos[one.photo], one.face, one.name, head)
                    fitted.append((one, fit))
                except InputError as error:
                    self.left_out.append(str(error))
                tell(done / len(found))
        return fitted

    def observe(
        self,
        fitted: Sequence[tuple[FoundFace, FaceFit]],
        *,
        grid_height: int,
        gloss: bool,
        workers: int | None = None,
        rays_on: torch.device | None = None,
    ) -> Iterator[SeenFace]:
        """Each face with its transport on so many rows, of the skin's gloss where that is wanted.

        ``workers`` are the processes that trace light, one per core where None; ``rays_on`` is that
        of :func:`~skylight.faces._observe.observe_face`.

        Raises
        ------
        InputError
            None can be used; the message says why.
        """
        heads, count = HeadModel.load(), 0
        with self.stage(STAGES[2]) as tell:
            for done, (one, fit) in enumerate(fitted):

                def told(share: float, done: int = done) -> None:
                    tell((done + share) / len(fitted))

                photo = self.photos[one.photo]
                try:
                    view = observe_face(
                        photo.pixels,
                        photo.clipped,
                        heads,
                        fit,
                        grid_height=grid_height,
                        specular=SKIN_GLOSS if gloss else None,
                        grey=photo.grey,
                        workers=workers or os.cpu_count() or 1,
                        rays_on=rays_on,
                        progress=told,
                    )
                except InputError as error:
                    self.left_out.append(f"{one.name}: {error}")
                    continue
                count += 1
                yield SeenFace(**vars(one), fit=fit, view=view)
        if count == 0:
            raise InputError("; ".join(self.left_out))

    def result(self, light: Estimate, seen: Sequence[SeenFace]) -> PhotoEstimate:
        """The estimate from the faces ``seen``, with all that is to know of it."""
        unsure = [
            f"{one.name}: hardly a face (score {one.face.score:.2f}); check the mesh overlay"
            for one in seen
            if one.face.score < 0
        ]
        no_heads = [one for one in seen if one.fit.landmark_error > NO_HEAD]
        for one in no_heads:
            off = f"{100 * one.fit.landmark_error:.0f} % of the eyes' distance"
            unsure.append(
                f"{one.name}: hardly a face (landmarks are {off} off the head); check the mesh "
                "overlay"
            )
        if len(no_heads) == len(seen):
            posterior = replace(light.posterior, verdict="unreliable: hardly a face")
            light = replace(light, posterior=posterior)
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
