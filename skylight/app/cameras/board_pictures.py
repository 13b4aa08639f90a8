"""Photographs of a probe over its marker board, read for all kinds of probes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from skylight.cameras.board import Board, load_board
from skylight.cameras.frames import Frame
from skylight.cameras.intrinsics import Intrinsics, load_intrinsics
from skylight.cameras.pose import BoardPose, board_pose
from skylight.cameras.response import Response, load_response
from skylight.errors import InputError
from skylight.sphere.rigid_transform import RigidTransform
from skylight.work.progress import Tell

MOVED = 0.1  # of a face's shading: more is another light, or another pose than was thought


@dataclass(frozen=True, kw_only=True)
class Setup:
    """The camera, its response, and the board that it looks for."""

    intrinsics: Intrinsics
    response: Response
    board: Board


def read_setup(camera: Path, board: Path, response: Path | None) -> Setup:
    """The files of `skylight camera`; without a response, pictures are sRGB."""
    return Setup(
        intrinsics=load_intrinsics(camera),
        response=Response() if response is None else load_response(response),
        board=load_board(board),
    )


class BoardPictures:
    """Goes once through pictures: each in which the board is found comes with the camera's pose.

    ``used`` names those, ``left_out`` the others with their reasons.
    """

    def __init__(self, frames: Iterable[Frame], setup: Setup) -> None:
        self._frames, self._setup = frames, setup
        self.used: list[str] = []
        self.left_out: list[tuple[str, str]] = []

    def __iter__(self) -> Iterator[tuple[Frame, RigidTransform]]:
        for frame in self._frames:
            found = board_pose(frame.image, self._setup.board, self._setup.intrinsics)
            if found is None or found.is_ambiguous:
                self.left_out.append((frame.name, why_unusable(found)))
                continue
            self.used.append(frame.name)
            yield frame, found.pose

    def require_some(self) -> None:
        """Refuse pictures of which none could be used."""
        if not self.used:
            reasons = "; ".join(sorted({reason for _, reason in self.left_out}))
            raise InputError(
                f"none of {len(self.left_out)} pictures can be used ({reasons}): the whole probe "
                "and most of the board must be in view, sharp, and of the board that was named"
            )


def why_unusable(found: BoardPose | None) -> str:
    """Of a picture in which the board was not found, or ambiguously."""
    if found is None:
        return "no marker board in view"
    return "the board is too small or too flat in view to tell its tilt"


def require_capture(before: Path, *, more: bool, most: int) -> None:
    """Refuse to overwrite the file of a capture, or to continue one that is not there."""
    if most < 1:
        raise InputError(f"at least 1 frame is needed, got {most}")
    if more != before.exists():
        raise InputError(
            f"{before.parent} has no capture to continue: leave --more out"
            if more
            else f"{before.parent} has a capture: add --more to continue it, or choose another "
            "folder"
        )


def report_warnings(left_out: list[tuple[str, str]], warnings: list[str], warn: Tell) -> None:
    """What a capture has to say about its pictures."""
    for name, reason in left_out:
        warn(f"left out {name}: {reason}")
    for warning in warnings:
        warn(warning)
