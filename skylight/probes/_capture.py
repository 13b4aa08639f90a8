"""Printed probes in photographs and films: what reading them has in common, whatever the probe.

A capture finds the board in each picture, then by the probe's own edges in all pictures where the
probe stands, and then reads the faces that each picture shows whole (thesis, sections 3.5.2 and
4.6.1). A live view follows the board from frame to frame, adds what the frame shows of the probe
and draws something virtual in its light.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight import __version__
from skylight.errors import InputError
from skylight.io._bounded import json_content, write_json
from skylight.probes.cameras._files import (
    BoardPictures,
    Setup,
    report_warnings,
    why_unusable,
)
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._live import (
    Clock,
    Frame,
    LiveFrame,
    LiveReport,
    read_frames,
    read_picture,
    write_film,
)
from skylight.probes.cameras._pose import board_pose, camera_centre, in_frame
from skylight.probes.cameras._tracking import BoardTracker
from skylight.sphere._rotation import RigidTransform
from skylight.work._progress import Tell
from skylight.work._resumable import results_folder

_GRAZING = 0.17  # cosine: faces seen under less than 10 degrees tell little
Sees = Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "*n 3"]], Float[Tensor, "*n"]]


def faces_in_view(
    centres: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    outline: Float[np.ndarray, "n k 3"],
    guard: Float[np.ndarray, "n g 3"],
    sees: Sees,
    pose: RigidTransform,
    intrinsics: Intrinsics,
) -> list[int]:
    """The faces that a picture shows whole.

    Tested in the order of their cost: turned to the camera, all of the ``outline`` inside of the
    frame, and nothing between the camera and any place of ``guard``.
    """
    eye = camera_centre(pose)
    towards = eye - centres
    cosine = (towards * normals).sum(1) / np.linalg.norm(towards, axis=1)
    _, inside = in_frame(outline, pose, intrinsics)
    candidates = np.flatnonzero((cosine > _GRAZING) & inside)
    if not len(candidates):
        return []
    free = sees(eye, guard[candidates]).numpy().all(1)
    return candidates[free].tolist()


def polygon_areas(corners: Float[np.ndarray, "n k 2"]) -> Float[np.ndarray, " n"]:
    """Areas of polygons by the shoelace formula."""
    x, y = corners.transpose(2, 0, 1)
    return 0.5 * np.abs((x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y).sum(1))


def pose_in_photo(photo: Path, setup: Setup) -> tuple[UInt8[np.ndarray, "h w 3"], RigidTransform]:
    """(picture, camera_from_board) of a photograph of the board."""
    image = read_picture(photo).image
    found = board_pose(image, setup.board, setup.intrinsics)
    if found is None or found.is_ambiguous:
        raise InputError(f"{photo}: {why_unusable(found)}; show most of it, and larger")
    return image, found.pose


@dataclass(frozen=True, kw_only=True)
class PosedFrames:
    """Pictures that show the board, each with ``camera_from_board``; the others with a reason."""

    seen: list[tuple[Frame, RigidTransform]]
    left_out: list[tuple[str, str]]

    @staticmethod
    def of(frames: Iterable[Frame], setup: Setup) -> "PosedFrames":
        """The board found in each picture on its own; all pictures are held in memory."""
        pictures = BoardPictures(frames, setup)
        seen = list(pictures)
        pictures.require_some()
        return PosedFrames(seen=seen, left_out=pictures.left_out)

    def only(self, kept: Sequence[bool], reason: str) -> "PosedFrames":
        """Those of the pictures that are kept, the others left out for the reason."""
        pairs = list(zip(self.seen, kept, strict=True))
        gone = [(frame.name, reason) for (frame, _), stays in pairs if not stays]
        return PosedFrames(
            seen=[each for each, stays in pairs if stays], left_out=[*self.left_out, *gone]
        )

    @property
    def used(self) -> list[str]:
        """The pictures' names."""
        return [frame.name for frame, _ in self.seen]


@dataclass(frozen=True, kw_only=True)
class CaptureResult(ABC):
    """What pictures told; ``warnings`` are sentences for the user, empty when all went well."""

    used: list[str]
    left_out: list[tuple[str, str]]
    warnings: list[str]

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write what was captured, and assembly.json with the probe where it was found to stand."""

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """What capture.json holds of this kind of probe, in plain numbers."""

    @abstractmethod
    def summary(self) -> str:
        """What was captured, and where the probe stood, in one line."""

    def report(self, earlier: Mapping[str, object]) -> dict[str, object]:
        """All of capture.json, after the pictures of an ``earlier`` one that it adds to."""
        left_out = [{"name": name, "reason": reason} for name, reason in self.left_out]
        return {
            **self.describe(),
            "pictures": [*_listed(earlier, "pictures"), *self.used],
            "left_out": [*_listed(earlier, "left_out"), *left_out],
            "warnings": self.warnings,
            "version": __version__,
        }


_Result = TypeVar("_Result", bound=CaptureResult)


def write_capture(
    source: Path | Sequence[Path] | int,
    out: Path,
    capture: Callable[[Iterator[Frame]], _Result],
    *,
    most: int,
    more: bool,
    tell: Tell,
    warn: Tell,
) -> _Result:
    """Pictures captured into the folder ``out``, and what there is to say about them.

    ``more`` continues the report that is in ``out``. Nothing is written where ``capture`` fails.
    """
    earlier = _earlier_report(out / "capture.json") if more else {}
    with results_folder(out) as folder:
        found = capture(read_frames(source, most=most))
        found.save(folder)
        write_json(folder / "capture.json", found.report(earlier))
    report_warnings(found.left_out, found.warnings, warn)
    tell(f"{out}: {found.summary()}")
    return found


def place_found(turn_deg: float, shift_mm: float, alike: str = "") -> str:
    """How far from its place in the assembly's file a probe was found; ``alike`` qualifies it."""
    return (
        f"the probe stands {turn_deg:.1f} degrees{alike} and {shift_mm:.1f} mm off its place; "
        "allowed for"
    )


def _earlier_report(path: Path) -> Mapping[str, object]:
    """The report of the earlier capture; empty where there is none."""
    try:
        content = json_content(path) if path.exists() else {}
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path} ({error}): take it away or mend it") from error
    return content if isinstance(content, dict) else {}


def _listed(content: Mapping[str, object], key: str) -> list[object]:
    found = content.get(key)
    return found if isinstance(found, list) else []


class LiveView(ABC):
    """Camera frames to frames with something virtual in them, one after the other."""

    counted: str
    """What :attr:`known` counts, for the user."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self._tracker = BoardTracker(setup.board, setup.intrinsics)

    @property
    @abstractmethod
    def known(self) -> int:
        """How much of the probe was captured so far."""

    @abstractmethod
    def draw(
        self, image: UInt8[np.ndarray, "h w 3"], pose: RigidTransform, clock: Clock
    ) -> UInt8[np.ndarray, "h w 3"] | None:
        """Capture what a frame shows and draw into it; None while too little is known."""

    def show(self, image: UInt8[np.ndarray, "h w 3"]) -> LiveFrame:
        """The frame with what is drawn into it, as soon as enough of the probe was seen."""
        clock = Clock()
        found = self._tracker.pose(image)
        clock.mark("track")
        drawn = None
        # a mirrored pose would spoil what is captured
        tracked = found is not None and not found.is_ambiguous
        if found is not None and tracked:
            drawn = self.draw(image, found.pose, clock)
        return LiveFrame(
            picture=image if drawn is None else drawn,
            tracked=tracked,
            known=self.known,
            times=clock.times,
        )

    def write(self, source: Path | int, out: Path, *, most: int | None, tell: Tell) -> LiveReport:
        """A whole video or webcam as a film ``out`` (.mp4); see :func:`.write_film`."""
        size = self.setup.intrinsics.width, self.setup.intrinsics.height
        report = write_film(source, out, self.show, size=size, most=most)
        tell(report.sentence(out, self.counted))
        return report
