"""The light of a film of one person, or of a folder of its frames.

What following the person found is kept between runs, beside the results.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight._modes import without_autocast
from skylight.errors import InputError
from skylight.estimation._manifest import file_hash
from skylight.estimation._settings import EstimateSettings
from skylight.estimation.film._follow import (
    FOLLOWED,
    Followed,
    Keyframe,
    Shot,
    Source,
    follow,
    read_followed,
    write_followed,
)
from skylight.estimation.film._head import fit_head
from skylight.estimation.film._light import FilmLight, FilmProblem, in_world
from skylight.faces._fit import FOCAL_GUESS, FOCAL_GUESS_SIGMA, MOST_FACING_ANGLE_RAD, FaceFit
from skylight.faces._mediapipe import MediaPipeLandmarker
from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.imaging._camera_turns import Link, focal_from_turns, world_from_cameras
from skylight.imaging._film import FilmFrame, film_frames, told_length_s
from skylight.imaging._photo import PHOTO_SUFFIXES, Photo, read_photo
from skylight.inverse._lamps import LampsProblem
from skylight.inverse._sky import SkyProblem
from skylight.io._files import visible_files
from skylight.models._base import is_sky, name_of
from skylight.work._progress import StageProgress
from skylight.work._resumable import results_folder
from skylight.work._threads import cores

FOLLOWING = "following"  # the folder in that of the results


FOLLOWED_A_SECOND = 10.0
# others are for photographs
_OPTIONS = ("light", "prior", "model", "face", "decode", "ground", "place")
MOST_SIDE = 1920
# Of a photograph's face: 0.4 of its height, a sixth of its pixels, of which films have many times
# as many.
FACE_HEIGHT_PX = 28
_KNOWN_FOCAL = 0.1  # a spread of its log below which turns of the camera tell the focal length
_WHOLE = 0.9  # of the length that a header tells: less is cut short


@dataclass(frozen=True, kw_only=True)
class FilmSettings:
    """What the light of a film depends on besides its pictures.

    Of ``estimate`` the :data:`_OPTIONS` count, and the device; ``keyframes`` are the most that
    light is estimated at, and ``rate`` is how many frames of a folder are shown in a second.
    """

    estimate: EstimateSettings = field(default_factory=EstimateSettings)
    keyframes: int = 24
    rate: float = 30.0

    def __post_init__(self) -> None:
        usual = EstimateSettings()
        for option, is_given in {
            "--faces all": self.estimate.face == "all",
            "--head": self.estimate.head != usual.head,
            "--landmarks": self.estimate.landmarks != usual.landmarks,
            "--solver": self.estimate.solver != usual.solver,
            "--detail": self.estimate.detail != usual.detail,
        }.items():
            if is_given:
                raise InputError(
                    f"{option}: not for films, in which one face is followed by MediaPipe"
                )
        light = self.estimate.light
        if light == "auto" or not (light == "sphere" or is_sky(light)):
            raise InputError(
                f"--video takes --light sphere, autoencoder or sunsky, not {name_of(light)}"
            )
        if self.keyframes < 1:
            raise InputError(f"--keyframes must be 1 or more, got {self.keyframes}")
        if not 0.001 <= self.rate <= 1000:
            raise InputError(f"--rate is frames a second, 0.001 to 1000, got {self.rate:g}")

    def facts(self, source: Path) -> dict[str, object]:
        """For the note beside the results: the same for the same pictures, wherever they lie."""
        told = self.estimate.facts()
        return {
            **{name: told[name] for name in _OPTIONS if name in told},
            "keyframes": self.keyframes,
            "rate": self.rate,
            "sha256": _sha256(source),
        }


@dataclass(frozen=True, kw_only=True)
class FilmEstimate:
    """The light of a film with everything on the way to it.

    ``keyframes``, ``fits`` and ``world_from_camera`` are those of ``light.frames``, in order;
    ``advice`` says what to know of the film.
    """

    light: FilmLight
    followed: Followed
    keyframes: tuple[Keyframe, ...]
    fits: tuple[FaceFit, ...]
    world_from_camera: tuple[Float[ndarray, "3 3"], ...]
    advice: tuple[str, ...]


@without_autocast
def estimate_film(
    source: Path, out: Path, settings: FilmSettings, progress: StageProgress | None = None
) -> FilmEstimate:
    """Follow the person, fit one head, estimate one light that drifts.

    What following found is kept in ``out``/following: a run that was stopped goes on there.

    Raises
    ------
    InputError
        A film that cannot be read, is too long, or in which no face can be used.
    """
    tell = progress or (lambda _stage, _share: None)
    followed = followed_film(source, out, settings, progress)
    shot, size = followed.shot, followed.size
    advice = list(followed.notes)
    (problem,) = settings.estimate.problems()
    assert isinstance(problem, SkyProblem | LampsProblem)
    known_px = _photo(shot.keyframes[0], settings).focal_px
    guess_px = known_px or FOCAL_GUESS * max(size)
    if known_px is None:
        turned_px, spread = focal_from_turns(shot.links, guess_px, FOCAL_GUESS_SIGMA, size)
        known_px = turned_px if spread < _KNOWN_FOCAL else None
    heads = HeadModel.load()
    tell("fitting the head", 0.0)
    fits = fit_head(heads, [one.face for one in shot.keyframes], size, focal_px=known_px)
    focal_px = fits[0].camera.focal_px
    world, untold = world_from_cameras(shot.links, focal_px, size)
    advice += turn_notes(shot, untold)
    film = FilmProblem(problem)
    kept: list[int] = []
    for k, (keyframe, fit) in enumerate(zip(shot.keyframes, fits, strict=True)):
        tell("tracing light", k / len(fits))
        photo = _photo(keyframe, settings)
        try:
            if fit.facing_angle_rad > MOST_FACING_ANGLE_RAD:
                raise InputError(
                    f"the face is turned away by {np.degrees(fit.facing_angle_rad):.0f} degrees"
                )
            view = observe_face(
                photo.pixels,
                photo.clipped,
                heads,
                fit,
                face_height_px=FACE_HEIGHT_PX,
                grid_height=problem.grid_height,
                grey=photo.grey,
                beside=None,
                workers=cores(),
                rays_on=settings.estimate.rays_on,
            )
        except InputError as error:
            advice.append(f"left out: {keyframe.time_s:.1f} s: {error}")
            continue
        turn = world.get(keyframe.number, np.eye(3))
        film.add(in_world(view.observation, turn), keyframe.time_s)
        kept.append(k)
    if not kept:
        raise InputError(f"{source}: no keyframe can be used; {advice[-1]}")
    light = film.solve(lambda share: tell("estimating the light", share))
    return FilmEstimate(
        light=light,
        followed=followed,
        keyframes=tuple(shot.keyframes[k] for k in kept),
        fits=tuple(fits[k] for k in kept),
        world_from_camera=tuple(world.get(shot.keyframes[k].number, np.eye(3)) for k in kept),
        advice=(*light.start.advice, *advice),
    )


def turn_notes(shot: Shot, untold: list[Link]) -> list[str]:
    """What to know of the camera, in a line."""
    if not untold:
        return []
    times = {one.number: one.time_s for one in shot.keyframes}
    told = len(shot.links) - len(untold)
    ends = [times[link.end] for link in untold if link.end in times]
    when = "" if told == 0 or not ends else f" at {', '.join(f'{t:.1f}' for t in ends[:5])} s"
    return [
        f"the camera's turn cannot be told{when} (too little of the background is seen to keep "
        "together): it is taken to stand still"
    ]


def followed_film(
    source: Path, out: Path, settings: FilmSettings, progress: StageProgress | None = None
) -> Followed:
    """What following finds, or found in an earlier run, which ``out``/following keeps."""
    tell = progress or (lambda _stage, _share: None)
    kept = out / FOLLOWING
    if not (kept / FOLLOWED).exists():
        sources, length_s = _sources(source, settings)
        face = settings.estimate.face
        assert isinstance(face, int)
        found = follow(
            sources,
            str(source),
            MediaPipeLandmarker(),
            face=face,
            most=settings.keyframes,
            duration_s=length_s,
            progress=lambda share: tell("following the face", share),
        )
        if length_s is not None and found.end_s + 1 / FOLLOWED_A_SECOND < _WHOLE * length_s:
            note = f"cut short: pictures end at {found.end_s:.1f} of {length_s:.1f} s"
            found = replace(found, notes=(*found.notes, note))
        with results_folder(kept) as folder:
            write_followed(folder, found)
    return read_followed(kept)


def _sources(source: Path, settings: FilmSettings) -> tuple[Iterator[Source], float | None]:
    """At most :data:`FOLLOWED_A_SECOND`, and how long the film is, where its header tells.

    Of a folder in the order of the files' names.
    """
    if source.is_dir():
        files = _frame_files(source)
        return _of_folder(files, settings), len(files) / settings.rate
    frames = film_frames(source, most_a_second=FOLLOWED_A_SECOND, most_side=MOST_SIDE)
    return (Source(frame=frame) for frame in frames), told_length_s(source)


def _of_folder(files: Sequence[Path], settings: FilmSettings) -> Iterator[Source]:
    for number in range(0, len(files), max(1, round(settings.rate / FOLLOWED_A_SECOND))):
        codes = read_photo(files[number], decode=settings.estimate.decode).encoded
        frame = FilmFrame(number=number, time_s=number / settings.rate, codes=codes)
        yield Source(frame=frame, file=files[number])


def _frame_files(folder: Path) -> list[Path]:
    files = visible_files(folder, PHOTO_SUFFIXES)
    if not files:
        raise InputError(
            f"{folder}: no pictures ({', '.join(sorted(PHOTO_SUFFIXES))}) in this folder"
        )
    return files


def _photo(keyframe: Keyframe, settings: FilmSettings) -> Photo:
    assert isinstance(keyframe.picture, Path)  # as they are kept
    return read_photo(keyframe.picture, decode=settings.estimate.decode)


def _sha256(source: Path) -> str:
    if not source.is_dir():
        return file_hash(source)
    digest = hashlib.sha256()
    for file in _frame_files(source):
        digest.update(f"{file.name}\0{file_hash(file)}\n".encode())
    return digest.hexdigest()
