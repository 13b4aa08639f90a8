"""One person followed through a film: landmarks, keyframes, and what the background does.

Of the frames with the face, every n-th since the
last cut is a keyframe, n doubling whenever there are too many: so keyframes are spread evenly,
however long the film is, and no more than they are held in memory.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from skylight.errors import InputError
from skylight.estimation.film._one_face import LEAST_PRESENCE, OneFace
from skylight.faces._landmarks import DetectedFace
from skylight.faces._mediapipe import MediaPipeLandmarker, Reading, square_of_landmarks, to_ibug
from skylight.imaging._camera_turns import BackgroundCorners, Link
from skylight.imaging._film import FilmFrame
from skylight.io._files import write_png
from skylight.io._tensors import read_tensors, write_tensors
from skylight.work._progress import Progress

FOLLOWED = "followed.safetensors"  # what was found, kept between runs
_FACTS = "facts"
LONGEST_S = 600.0
_GAP_S = 0.5  # shorter ones are not told
# A cut: the small picture is unlike the one before, and few corners are found again.
ALIKE, _LEAST_KEPT = 0.6, 0.25
_THUMBNAIL = (48, 32)
# Of the face's height and width: hair above and beside it, shoulders below.
_ABOVE, _BESIDE, _SHOULDERS = 0.5, 0.25, 1.1


@dataclass(frozen=True, kw_only=True)
class Keyframe:
    """A frame whose light is estimated: ``picture`` is its codes, or the file that it came from."""

    number: int
    time_s: float
    face: DetectedFace
    picture: UInt8[ndarray, "h w 3"] | Path


@dataclass(kw_only=True)
class Shot:
    """Frames between cuts. ``links`` begin at frame ``first``; ``gaps`` are times without a face.

    ``seen_s`` is how long the face was followed. ``end_s`` is the last of its frames that was
    looked at, and ``until_s`` the next shot's first: the cut lies after the one, and not after the
    other. Of the last shot it is infinite.
    """

    first: int
    begin_s: float
    end_s: float
    until_s: float = math.inf
    seen_s: float = 0.0
    keyframes: list[Keyframe] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    gaps: list[tuple[float, float]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Followed:
    """The shot in which one person was followed longest; pictures are of ``size`` (width, height).

    ``notes`` say in a line each what else was in the film; ``frames`` is how many were followed,
    the last at ``end_s``.
    """

    shot: Shot
    size: tuple[int, int]
    frames: int
    end_s: float
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Source:
    """A frame, and its file where it has one of its own."""

    frame: FilmFrame
    file: Path | None = None


def follow(
    sources: Iterable[Source],
    name: str,
    landmarker: MediaPipeLandmarker,
    *,
    face: int = 1,
    most: int = 24,
    duration_s: float | None = None,
    progress: Progress | None = None,
) -> Followed:
    """Follow face number ``face`` (1 is the largest) of the first frame that has one.

    At most ``most`` keyframes. Of several shots the one in which a face is seen longest is kept.
    ``duration_s`` is the film's, where its header tells; :data:`LONGEST_S` at most.
    """
    _require_short(name, duration_s or 0.0)
    following: _Following | None = None
    for source in sources:
        _require_short(name, source.frame.time_s)  # headers may tell less than there is
        if following is None:
            following = _Following(source, name, landmarker, face, most)
        else:
            following.add(source)
        if progress is not None and duration_s:
            progress(min(source.frame.time_s / duration_s, 1.0))
    if following is None:
        raise InputError(f"{name}: it holds no pictures; record it again")
    return following.end()


def _require_short(name: str, length_s: float) -> None:
    if length_s > LONGEST_S:
        raise InputError(
            f"{name}: it is {length_s / 60:.0f} minutes long, and at most "
            f"{LONGEST_S / 60:.0f} are followed; cut out the part that shows the person"
        )


class _Following:
    def __init__(
        self, first: Source, name: str, landmarker: MediaPipeLandmarker, face: int, most: int
    ) -> None:
        self.name, self.landmarker, self.most = name, landmarker, most
        self.one = OneFace(landmarker, name, face)
        height, width = first.frame.codes.shape[:2]
        self.size = width, height
        self.corners = BackgroundCorners(width, height)
        self.best: Shot | None = None
        self.cuts: list[float] = []
        self._begin(first)

    def _begin(self, source: Source) -> None:
        """A new shot with that frame."""
        frame = source.frame
        self.shot = Shot(first=frame.number, begin_s=frame.time_s, end_s=frame.time_s)
        self.one.begin()
        self.lost_s: float | None = None
        self.stride_count = 0
        self.stride = 1
        self.anchor = frame.number
        self.thumbnail = thumbnail(frame.codes)
        self._look(source)
        self.corners.anchor(frame.codes, self._background())

    def add(self, source: Source) -> None:
        frame = source.frame
        height, width = frame.codes.shape[:2]
        if (width, height) != self.size:
            was_width, was_height = self.size
            raise InputError(
                f"{self.name}, frame {frame.number + 1}: {width}x{height} pixels, but the first "
                f"has {was_width}x{was_height}; give frames of one film"
            )
        before, self.thumbnail = self.thumbnail, thumbnail(frame.codes)
        kept = self.corners.follow(frame.codes, self._background())
        if float((before * self.thumbnail).mean()) < ALIKE and kept < _LEAST_KEPT:
            self.cuts.append(frame.time_s)
            self.shot.until_s = frame.time_s
            self._close()
            self._begin(source)
            return
        since_s = frame.time_s - self.shot.end_s
        self.shot.end_s = frame.time_s
        self._look(source)
        if self.one.points is not None and self.lost_s is None:
            self.shot.seen_s += since_s
        if self.corners.is_worn:
            if not self.shot.links or self.shot.links[-1].end != frame.number:
                self.shot.links.append(self.corners.link(self.anchor, frame.number))
            self.corners.anchor(frame.codes, self._background())
            self.anchor = frame.number

    def end(self) -> Followed:
        self._close()
        best = self.best
        if best is None or not best.keyframes:
            raise InputError(
                f"{self.name}: no face found in {self.one.frames} frames; use a film of a face "
                "seen from the front, at least 60 pixels high"
            )
        notes = list(self.one.notes)
        if self.cuts:
            at = ", ".join(f"{time_s:.1f}" for time_s in self.cuts[:5])
            more = f" and {len(self.cuts) - 5} more" if len(self.cuts) > 5 else ""
            notes.append(
                f"cuts at {at} s{more}: the shot from {best.begin_s:.1f} to {best.end_s:.1f} s is "
                "used, which shows the face longest"
            )
        notes += [f"no face from {begin:.1f} to {end:.1f} s" for begin, end in best.gaps]
        return Followed(
            shot=best,
            size=self.size,
            frames=self.one.frames,
            end_s=self.shot.end_s,
            notes=tuple(notes),
        )

    def _close(self) -> None:
        if self.lost_s is not None:
            self._found_again(self.shot.end_s)
        if self.best is None or self.shot.seen_s > self.best.seen_s or not self.best.keyframes:
            self.best = self.shot

    def _look(self, source: Source) -> None:
        """Where the face is in this frame; one in ``stride`` becomes a keyframe."""
        frame = source.frame
        points = self.one.look(frame)
        if points is None:
            if self.lost_s is None:
                self.lost_s = frame.time_s
            return
        if self.lost_s is not None:
            self._found_again(frame.time_s)
        if self.stride_count % self.stride == 0:
            self._keep(source, points)
        self.stride_count += 1

    def _found_again(self, time_s: float) -> None:
        assert self.lost_s is not None
        if time_s - self.lost_s >= _GAP_S:
            self.shot.gaps.append((self.lost_s, time_s))
        self.lost_s = None

    def _keep(self, source: Source, points: Float[ndarray, "478 2"]) -> None:
        frame, shot = source.frame, self.shot
        reading = self.landmarker.read(frame.codes, square_of_landmarks(points))
        if reading.presence < LEAST_PRESENCE:
            return
        keyframe = Keyframe(
            number=frame.number,
            time_s=frame.time_s,
            face=_face(reading),
            picture=frame.codes if source.file is None else source.file,
        )
        shot.keyframes.append(keyframe)
        if frame.number != self.anchor:
            shot.links.append(self.corners.link(self.anchor, frame.number))
        if len(shot.keyframes) > self.most:
            self.stride *= 2
            gone = {one.number for one in shot.keyframes[1::2]}
            shot.keyframes = shot.keyframes[::2]
            starts = {link.start for link in shot.links} | {self.anchor}
            shot.links = [one for one in shot.links if one.end not in gone or one.end in starts]

    def _background(self) -> Bool[ndarray, "h w"]:
        """Everything but the head where it was last, and what is below and beside it."""
        width, height = self.size
        mask = np.ones((height, width), bool)
        if self.one.points is None:
            return mask
        (left, top), (right, bottom) = self.one.points.min(0), self.one.points.max(0)
        wide, high = right - left, bottom - top
        middle = (left + right) / 2
        _cover(mask, left - _BESIDE * wide, right + _BESIDE * wide, top - _ABOVE * high, bottom)
        shoulders = _SHOULDERS * wide
        _cover(mask, middle - shoulders, middle + shoulders, bottom, float(height))
        return mask


def _cover(
    mask: Bool[ndarray, "h w"], left: float, right: float, top: float, bottom: float
) -> None:
    columns = slice(max(int(left), 0), max(int(np.ceil(right)), 0))
    mask[max(int(top), 0) : max(int(np.ceil(bottom)), 0), columns] = False


def _face(reading: Reading) -> DetectedFace:
    return DetectedFace(
        points=to_ibug(reading.points), score=reading.presence, readings=reading.readings
    )


def thumbnail(codes: UInt8[ndarray, "h w 3"]) -> Float[ndarray, "a b"]:
    """Small and grey, of mean 0 and variance 1: the mean product of two is their correlation."""
    small = cv2.resize(codes, _THUMBNAIL, interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float64)
    return (grey - grey.mean()) / max(float(grey.std()), 1.0)


def write_followed(folder: Path, followed: Followed) -> None:
    """followed.safetensors, and a picture of each keyframe that has no file of its own."""
    shot, pictures, readings = followed.shot, [], []
    for keyframe in shot.keyframes:
        assert keyframe.face.readings is not None  # MediaPipe's
        readings.append(keyframe.face.readings)
        if isinstance(keyframe.picture, Path):
            pictures.append(str(keyframe.picture.resolve()))
        else:
            pictures.append(f"keyframe_{keyframe.number:06d}.png")
            write_png(folder / pictures[-1], keyframe.picture)
    counts = [len(link.before) for link in shot.links]
    none = np.zeros((0, 2))
    facts = {
        "pictures": pictures,
        "size": followed.size,
        "frames": followed.frames,
        "end_s": followed.end_s,
        "notes": followed.notes,
        "shot": [shot.first, shot.begin_s, shot.end_s, shot.seen_s],
        "until_s": None if math.isinf(shot.until_s) else shot.until_s,
        "gaps": shot.gaps,
    }
    tensors = {
        "readings": np.array(readings),
        "scores": np.array([one.face.score for one in shot.keyframes]),
        "numbers": np.array([one.number for one in shot.keyframes]),
        "times_s": np.array([one.time_s for one in shot.keyframes]),
        "links": np.array([[link.start, link.end] for link in shot.links]).reshape(-1, 2),
        "counts": np.array(counts, dtype=np.int64),
        "before": np.concatenate([none, *(link.before for link in shot.links)]),
        "after": np.concatenate([none, *(link.after for link in shot.links)]),
    }
    write_tensors(
        folder / FOLLOWED,
        {name: torch.from_numpy(array) for name, array in tensors.items()},
        {_FACTS: json.dumps(facts)},
    )


def read_followed(folder: Path) -> Followed:
    """What :func:`write_followed` wrote; pictures are their files."""
    try:
        tensors, metadata = read_tensors(folder / FOLLOWED)
        arrays = {name: tensor.numpy() for name, tensor in tensors.items()}
        return _followed(folder, arrays, json.loads(metadata[_FACTS]))
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError,
            RecursionError) as error:  # fmt: skip
        reason = " ".join(str(error).split())
        raise InputError(
            f"{folder / FOLLOWED}: damaged ({reason}); delete {folder}, and the film is followed "
            "again"
        ) from error


def _followed(folder: Path, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> Followed:
    """What arrays and facts say; any error of a look-up, type or value where they cannot be."""
    first, begin_s, end_s, seen_s = facts["shot"]
    shot = Shot(
        first=first,
        begin_s=begin_s,
        end_s=end_s,
        until_s=math.inf if facts["until_s"] is None else float(facts["until_s"]),
        seen_s=seen_s,
        gaps=[(begin, end) for begin, end in facts["gaps"]],
    )
    for k, picture in enumerate(facts["pictures"]):
        readings = arrays["readings"][k]
        face = DetectedFace(
            points=to_ibug(readings.mean(0)),
            score=float(arrays["scores"][k]),
            readings=readings,
        )
        shot.keyframes.append(
            Keyframe(
                number=int(arrays["numbers"][k]),
                time_s=float(arrays["times_s"][k]),
                face=face,
                picture=folder / picture,
            )
        )
    begin = 0
    for (start, end), count in zip(arrays["links"], arrays["counts"], strict=True):
        rows = slice(begin, begin + int(count))
        begin += int(count)
        shot.links.append(
            Link(
                start=int(start),
                end=int(end),
                before=arrays["before"][rows],
                after=arrays["after"][rows],
            )
        )
    width, height = facts["size"]
    return Followed(
        shot=shot,
        size=(width, height),
        frames=facts["frames"],
        end_s=facts["end_s"],
        notes=tuple(facts["notes"]),
    )
