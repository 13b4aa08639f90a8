"""A film of a person in another light, as steady as the film itself.

One light is taken away from all frames: the film's mean, in the world's frame. A gain is a ratio of
two lights, so exposures of single frames cancel; what is left to tremble is where the head is
(:mod:`skylight.portrait._poses`), what of the person a frame alone tells
(:class:`~skylight.portrait._relit.Held`) and its outline, which
:class:`~skylight.portrait._steady.Carried` carries on from frame to frame. A few frames are held at
a time, however long the film is.
"""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.errors import InputError
from skylight.estimation.film._kept import KeptFilm
from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel
from skylight.faces._observe import hair_of
from skylight.imaging._film import FilmFrame, film_frames, film_rate
from skylight.imaging._film_writer import WriteFrame, check_film_name, written_film
from skylight.imaging._photo import Photo, photo_from_codes
from skylight.io._atomic import require_place
from skylight.portrait._edge import EdgeLight
from skylight.portrait._files import RelitPortrait, shown
from skylight.portrait._lights import NewLight
from skylight.portrait._moving import MovingHead
from skylight.portrait._poses import Poses, film_poses
from skylight.portrait._relit import Gains, Held, Keep, Portrait, cut_out, light_in_photo
from skylight.portrait._room import white_of
from skylight.portrait._steady import Carried
from skylight.work._progress import StageProgress, silent
from skylight.work._threads import cores

HELD_FRAMES = 7  # that tell what all have in common
SETTLED = 4  # times that a shot's first frame is cut out again, as the next ones will be


@dataclass(frozen=True, kw_only=True)
class RelitFrame:
    """``codes`` (h,w,3) of a frame at ``time_s`` in each light; as they were where ``is_relit`` is
    False. ``gains`` are what was done to it, and ``doubts`` say why they are weaker."""

    time_s: float
    codes: Mapping[Path, UInt8[ndarray, "h w 3"]]
    gains: Mapping[Path, Gains]
    doubts: tuple[str, ...]
    is_relit: bool


def relight_film(
    film: KeptFilm,
    lights: Mapping[Path, NewLight],
    *,
    keep: Keep = "place",
    exposure: float = 1.0,
    workers: int | None = None,
    progress: StageProgress = silent,
) -> tuple[str, ...]:
    """Write the film in each of the lights (.mp4, or .mkv without loss), without sound.

    Lights are in the world's frame, as :func:`~skylight.portrait.key_light` makes them of a
    ``film``; ``keep`` is of :meth:`~skylight.portrait._relit.Portrait.under`.

    All of it, at a constant rate: where the film's own varies, frames are repeated or left out so
    that each is shown at its time to half a frame. Frames without the person, or of other shots,
    are as they were.

    Returns
    -------
    What there is to know of it, a line each.

    Raises
    ------
    InputError
        As :func:`~skylight.portrait._poses.film_poses`; a film is named otherwise, or is the one
        that is relit.
    OutputError
        A film cannot be written there; none of them is left half written.
    """
    for path in lights:
        check_film_name(path)
        require_place(path)
        if path.resolve() == film.file.resolve():
            raise InputError(f"{path} is the film itself: name another one")
    poses = film_poses(film, lambda share: progress("following the head", share))
    rate = film_rate(film.file)
    writes: dict[Path, WriteFrame] = {}
    doubts: set[str] = set()
    written, last = 0, None
    with ExitStack() as files:
        for frame in relit_frames(
            film, poses, lights, keep=keep, exposure=exposure, workers=workers, progress=progress
        ):
            if not writes:
                for path, codes in frame.codes.items():
                    size = codes.shape[1], codes.shape[0]
                    writes[path] = files.enter_context(written_film(path, rate, size))
            doubts |= {*frame.doubts}
            # until now the frame before was shown
            due = round(frame.time_s * rate)
            while last is not None and written < due:
                _write(writes, last)
                written += 1
            last = frame
        if last is not None:
            _write(writes, last)
    notes = [*film.advice, film.warning, *sorted(doubts)]
    notes += [f"no face from {a:.1f} to {b:.1f} s: relit less" for a, b in poses.gaps]
    return tuple(dict.fromkeys(note for note in notes if note))


def _write(writes: Mapping[Path, WriteFrame], frame: RelitFrame) -> None:
    for path, codes in frame.codes.items():
        writes[path](codes)


def relit_frames(
    film: KeptFilm,
    poses: Poses,
    lights: Mapping[Path, NewLight],
    *,
    keep: Keep = "place",
    exposure: float = 1.0,
    workers: int | None = None,
    progress: StageProgress = silent,
) -> Iterator[RelitFrame]:
    """Every frame of the film in order, in each of the lights, times an ``exposure``."""
    relighter = _Relighter(film, poses, lights, keep, exposure, workers, progress)
    numbers = {int(number): n for n, number in enumerate(poses.numbers)}
    for frame in film_frames(film.file):
        n = numbers.get(frame.number)
        gains: Mapping[Path, Gains] = {}
        if n is None or poses.shares[n] == 0:
            relighter.cut()
        else:
            gains = relighter.gains(frame, n)
            progress("relighting", n / len(numbers))
        yield RelitFrame(
            time_s=frame.time_s,
            codes={path: relighter.codes(frame, gains.get(path)) for path in lights},
            gains=gains,
            doubts=relighter.doubts if gains else (),
            is_relit=bool(gains),
        )


class _Relighter:
    """Frames one after the other: what of the last is needed for the next."""

    def __init__(
        self,
        film: KeptFilm,
        poses: Poses,
        lights: Mapping[Path, NewLight],
        keep: Keep,
        exposure: float,
        workers: int | None,
        progress: StageProgress,
    ) -> None:
        self.film, self.poses, self.lights = film, poses, lights
        self.keep: Keep = keep
        self.exposure = exposure
        self.found = light_in_photo(film)
        self.carried, self.before = Carried(), dict[Path, Gains]()
        self.matte: Float[ndarray, "h w"] | None = None
        self.hair: Float[ndarray, "h w"] | None = None
        self.portrait: Portrait | None = None
        self.held: Held | None = None
        self.factors: Mapping[Path, float] = {}
        self._prepare(workers, progress)

    def _prepare(self, workers: int | None, progress: StageProgress) -> None:
        """Trace the head where it is seen best; find what all frames have in common."""
        heads, film, poses = HeadModel.load(), self.film, self.poses
        usable = np.flatnonzero(poses.seen)
        chosen = usable[np.linspace(0, len(usable) - 1, HELD_FRAMES).round().astype(int)]
        wanted = {int(poses.numbers[n]): int(n) for n in chosen}
        seen = {
            wanted[frame.number]: photo
            for frame in film_frames(film.file)
            if frame.number in wanted and (photo := self._photo(frame)) is not None
        }
        if not seen:
            raise InputError(f"{film.file}: black where the face was; estimate the film again")
        best = min(seen, key=lambda n: film.fit(poses.states[n]).facing_angle_rad)
        fit = self._fit(best, seen[best])
        self.head = MovingHead.of(
            fit,
            hair_of(seen[best].pixels, heads, fit),
            workers=workers or cores(),
            progress=lambda share: progress("tracing light", share),
        )
        some = [one for n, photo in seen.items() if (one := self._taken_apart(photo, n))]
        if not some:
            raise InputError(f"{film.file}: no skin of the face can be relit; choose another film")
        self.held, self.matte = Held.of(some), None
        if self.keep == "brightness":
            self.factors = {
                path: float(np.median([self._own(path, one, np.eye(3)).factor for one in some]))
                for path in self.lights
            }

    def _photo(self, frame: FilmFrame) -> Photo | None:
        """None of a black frame."""
        try:
            return photo_from_codes(frame.codes, decode=self.film.decode)
        except InputError:
            return None

    def _fit(self, n: int, photo: Photo) -> FaceFit:
        height, width = photo.encoded.shape[:2]
        return self.film.fit(self.poses.states[n], (width, height))

    def _taken_apart(
        self, photo: Photo, n: int, before: Float[ndarray, "h w"] | None = None
    ) -> Portrait | None:
        """None where no skin is seen. ``before``: the last frame's matte, moved here."""
        fit = self._fit(n, photo)
        person = self.head.at(fit, self.poses.turns[n])
        hair = hair_of(photo.pixels, HeadModel.load(), fit)
        if self.hair is not None:  # in single frames skin is taken for it
            hair = self.carried.mixed(self.hair, hair)
        if self.held is not None:
            self.hair = hair
        hairy, matte = cut_out(photo, person, hair, before)
        for _ in range(SETTLED if before is None and self.held is not None else 0):
            hairy, matte = cut_out(photo, person, hair, matte)
        self.matte = matte
        try:
            return Portrait.of(
                photo.pixels,
                person,
                self.found,
                self.film.specular_scale,
                hairy,
                matte,
                grey=photo.grey,
                edit=self.film.edit,
                white=white_of(photo),
                held=self.held,
            )
        except InputError:  # no skin of it is seen
            return None

    def _own(self, path: Path, portrait: Portrait, turn: Float[ndarray, "3 3"]) -> Gains:
        """Those of one frame alone, but for how bright it is to be."""
        light, factor = self.lights[path], self.factors.get(path)
        edge = None if light.edge is None else _turned(light.edge, turn)
        return portrait.gains(
            light.environment, keep=self.keep, edge=edge, factor=factor, exposure=self.exposure
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why all frames are relit weaker."""
        return () if self.held is None else self.held.doubts

    def cut(self) -> None:
        """What comes next has nothing to do with what came before."""
        self.carried.forget()
        self.before, self.matte, self.hair, self.portrait = {}, None, None, None

    def gains(self, frame: FilmFrame, n: int) -> Mapping[Path, Gains]:
        """Of a frame in each light, none where it is black or shows no skin."""
        photo = self._photo(frame)
        if photo is None:
            self.cut()
            return {}
        self.carried.see(frame.codes)
        matte = None if self.matte is None else self.carried.moved(self.matte)
        self.portrait = self._taken_apart(photo, n, matte)
        if self.portrait is None:
            self.cut()
            return {}
        for path in self.lights:
            now = self._own(path, self.portrait, self.poses.turns[n])
            if path in self.before:
                now = self.carried.mean(self.before[path], now)
            self.before[path] = now
        share = float(self.poses.shares[n])
        return {path: _weaker(gains, share) for path, gains in self.before.items()}

    def codes(self, frame: FilmFrame, gains: Gains | None) -> UInt8[ndarray, "h w 3"]:
        """What is shown of a frame with those gains, in sRGB; None leaves it as it was."""
        exposure = self.exposure
        portrait = self.portrait
        if gains is None or portrait is None:
            photo = self._photo(frame)
            if photo is None or (exposure == 1 and self.film.decode is None):
                return frame.codes
            pixels, white = photo.pixels.numpy(), white_of(photo)
            return _shown(pixels, exposure * pixels, white)
        return _shown(portrait.photo, exposure * portrait.changed(gains), portrait.white)


def _shown(
    photo: Float[ndarray, "h w 3"], picture: Float[ndarray, "h w 3"], white: float
) -> UInt8[ndarray, "h w 3"]:
    return shown(
        RelitPortrait(picture=picture, photo=photo, exposure=1.0, warning="", notes=(), white=white)
    )


def _weaker(gains: Gains, share: float) -> Gains:
    """The same, of a light that is only ``share`` there."""
    if share == 1:
        return gains
    edge = None if gains.edge is None else share * gains.edge
    return replace(gains, times=gains.times**share, edge=edge)


def _turned(edge: EdgeLight, world_from_camera: Float[ndarray, "3 3"]) -> EdgeLight:
    """In the frame of a camera that is turned so."""
    x, y, z = (np.array(edge.direction) @ world_from_camera).tolist()
    return replace(edge, direction=(x, y, z))
