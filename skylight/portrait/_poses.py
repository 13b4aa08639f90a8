"""Where the head of a film's person is in every frame, smoothly."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from skylight.errors import InputError
from skylight.estimation.film._estimate import FOLLOWED_A_SECOND
from skylight.estimation.film._follow import ALIKE, thumbnail
from skylight.estimation.film._kept import KeptFilm
from skylight.estimation.film._one_face import OneFace
from skylight.faces._fit import FitState
from skylight.faces._mediapipe import MediaPipeLandmarker
from skylight.faces._model import HeadModel
from skylight.faces._next_pose import followed_pose
from skylight.imaging._film import film_frames, told_length_s
from skylight.work._progress import Progress

STILL_S = 0.05  # standard deviation of the Gaussian over which poses are averaged in time
# So long after a face was seen last it is relit as before, and so long it takes to leave that
HELD_S, FADE_S = 0.25, 0.5
_NEAR_S = 1.5 / FOLLOWED_A_SECOND  # frames that were looked at are nearer to each other
_SAME_S = 1e-6


@dataclass(frozen=True, kw_only=True)
class Poses:
    """The frames of a shot with a face near them, in order: ``numbers`` and ``times_s`` (n,).

    ``states`` are the head's, and ``turns`` (n,3,3) the camera's, world from camera; ``shares``
    (n,) are how much of a new light the frame gets: 1, but less where no face was seen for long.
    Where the face was ``seen`` (n,) states are not only interpolated; ``gaps`` are times in which
    it was not, and so long that the light fades.
    """

    numbers: Int[ndarray, " n"]
    times_s: Float[ndarray, " n"]
    seen: Bool[ndarray, " n"]
    states: tuple[FitState, ...]
    turns: Float[ndarray, "n 3 3"]
    shares: Float[ndarray, " n"]
    gaps: tuple[tuple[float, float], ...]


def film_poses(film: KeptFilm, progress: Progress | None = None) -> Poses:
    """The person of a film followed from frame to frame, in pictures of ``film.size``.

    From each keyframe's pose on, by the landmarks of one glance a frame; shape and focal length are
    the film's. Where the face is not seen, poses are interpolated. All are averaged over
    :data:`STILL_S`, which halves the noise of landmarks and makes a nod twice a second of 5
    degrees one of 4.

    Raises
    ------
    InputError
        The film cannot be read, or the person is not found in it.
    """
    found = _of_shot(list(_followed(film, progress)), film.shot)
    numbers = np.array([one.number for one in found], dtype=int)
    times_s = np.array([one.time_s for one in found])
    seen = np.array([one.state is not None for one in found], dtype=bool)
    if not seen.any():
        raise InputError(f"{film.file}: the face is not found in it again; estimate the film again")
    states = [one.state for one in found if one.state is not None]
    shares = np.clip(1 - (apart(times_s, times_s[seen]) - HELD_S) / FADE_S, 0, 1)
    return Poses(
        numbers=numbers,
        times_s=times_s,
        seen=seen,
        states=_smooth(states, times_s[seen], times_s),
        turns=_between(film.times_s, film.world_from_camera, times_s).as_matrix(),
        shares=shares,
        gaps=tuple(_gaps(times_s, seen, shares)),
    )


def apart(times_s: Float[ndarray, " n"], seen_s: Float[ndarray, " s"]) -> Float[ndarray, " n"]:
    """How far each time is from the nearest of some in order, of which there is one at least."""
    after = np.searchsorted(seen_s, times_s)
    before_s = seen_s[np.maximum(after - 1, 0)]
    after_s = seen_s[np.minimum(after, len(seen_s) - 1)]
    return np.minimum(np.abs(times_s - before_s), np.abs(after_s - times_s))


class _Frame(NamedTuple):
    """``state`` is the head's where it is seen, ``alike`` the correlation with the frame before."""

    number: int
    time_s: float
    state: FitState | None
    alike: float


def _of_shot(found: list[_Frame], shot: tuple[float, float]) -> list[_Frame]:
    """Those of the shot: a cut lies between two frames that were looked at when the film was
    estimated, where the frame is least like the one before."""
    begin_s, end_s = shot
    first = sum(one.time_s < begin_s - _SAME_S for one in found)
    stop = sum(one.time_s < end_s - _SAME_S for one in found)
    late = sum(one.time_s < end_s - _NEAR_S for one in found)
    begin = _least_alike(found, 0, first)
    end = _least_alike(found, late, stop) if stop < len(found) else None
    return found[first if begin is None else begin : stop if end is None else end]


def _least_alike(found: list[_Frame], first: int, last: int) -> int | None:
    n = min(range(first, last + 1), key=lambda k: found[k].alike, default=None)
    return n if n is not None and found[n].alike < ALIKE else None


def _followed(film: KeptFilm, progress: Progress | None) -> Iterator[_Frame]:
    """The frames of the shot, those about its begin, and the first of the next."""
    tell, heads = progress or (lambda _share: None), HeadModel.load()
    keyframes = {int(number): k for k, number in enumerate(film.frames)}
    one = OneFace(MediaPipeLandmarker(), str(film.file), film.face)
    state, (begin_s, end_s), before = film.poses[0], film.shot, None
    length_s = min(end_s, told_length_s(film.file) or math.inf)
    for frame in film_frames(film.file, most_side=max(film.size)):
        tell(min(frame.time_s / max(length_s, 1e-3), 1.0))
        small = thumbnail(frame.codes)
        alike = 1.0 if before is None else float((before * small).mean())
        before = small
        if frame.time_s < begin_s - _NEAR_S:
            continue
        if frame.time_s < begin_s - _SAME_S:
            yield _Frame(frame.number, frame.time_s, None, alike)
            continue
        if frame.time_s > end_s - _SAME_S:
            yield _Frame(frame.number, frame.time_s, None, alike)
            break
        k = keyframes.get(frame.number)
        if k is not None:
            one.begin(film.points[k])
            state = film.poses[k]
            yield _Frame(frame.number, frame.time_s, state, alike)
            continue
        try:
            points = one.look(frame)
        except InputError:  # fewer faces than the one that is followed, before it is seen
            points = None
        next_state = None if points is None else followed_pose(heads, state, points, film.size)
        state = next_state or state
        yield _Frame(frame.number, frame.time_s, next_state, alike)


def _smooth(
    states: list[FitState], seen_s: Float[ndarray, " s"], times_s: Float[ndarray, " n"]
) -> tuple[FitState, ...]:
    """Poses at all times, from those that were seen, averaged in time."""
    first = states[0]

    def averaged(values: Float[ndarray, "s *d"]) -> Float[ndarray, "n *d"]:
        flat = values.reshape(len(values), -1)
        there = np.stack([np.interp(times_s, seen_s, column) for column in flat.T], 1)
        step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0
        sigma = STILL_S / max(step_s, 1e-3)
        there = gaussian_filter1d(there, sigma, axis=0, mode="nearest") if sigma > 0.1 else there
        return there.reshape(len(times_s), *values.shape[1:])

    # the mean of rotations so near to each other is that of their matrices, made orthonormal
    matrices = averaged(np.array([state.rotation for state in states]))
    left, _, right = np.linalg.svd(matrices)
    rotations = left @ right
    depth = np.array([state.translation for state in states])
    translations = averaged(depth)
    expressions = averaged(np.array([state.expression for state in states]))
    return tuple(
        FitState(
            rotation=rotation,
            translation=translation,
            log_focal=first.log_focal,
            identity=first.identity,
            expression=expression,
        )
        for rotation, translation, expression in zip(
            rotations, translations, expressions, strict=True
        )
    )


def _between(
    known_s: Float[ndarray, " k"], turns: Float[ndarray, "k 3 3"], times_s: Float[ndarray, " n"]
) -> Rotation:
    """The camera's turns at all times, along great circles between keyframes."""
    if len(known_s) == 1:
        return Rotation.from_matrix(np.repeat(turns, len(times_s), axis=0))
    along = Slerp(known_s, Rotation.from_matrix(turns))
    return along(np.clip(times_s, known_s[0], known_s[-1]))


def _gaps(
    times_s: Float[ndarray, " n"], seen: Bool[ndarray, " n"], shares: Float[ndarray, " n"]
) -> Iterator[tuple[float, float]]:
    """From the first frame without the face to the next with it, or the last."""
    begins = np.flatnonzero(~seen & np.r_[True, seen[:-1]])
    ends = np.flatnonzero(seen & np.r_[False, ~seen[:-1]])
    for begin, end in zip_longest(begins, ends, fillvalue=len(seen)):
        if shares[begin:end].min() < 1:
            yield float(times_s[begin]), float(times_s[min(end, len(seen) - 1)])
