"""Files of cameras: boards to print, lenses, responses, and photographs of a probe on a board."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from skylight import __version__
from skylight._names import Page
from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.cameras._board import Board, load_board, save_board, write_board
from skylight.probes.cameras._calibrate import Calibration, calibrate
from skylight.probes.cameras._exposure_files import exif_exposures, exposure_times
from skylight.probes.cameras._intrinsics import Intrinsics, describe_intrinsics, load_intrinsics
from skylight.probes.cameras._live import FRAMES_MOST, Frame, read_frames, read_picture
from skylight.probes.cameras._pose import BoardPose, board_pose
from skylight.probes.cameras._response import (
    Response,
    load_response,
    recover_response,
    save_response,
)
from skylight.sphere._rotation import RigidTransform
from skylight.work._progress import Tell

MOVED = 0.1  # of a face's shading: more is another light, or another pose than was thought


def make_board(out: Path, board: Board, *, page: Page = "A4") -> None:
    """Draw a board on a page (.pdf or .svg) and write its measures beside it, as .json."""
    measures = out.with_suffix(".json")
    write_board(out, board, page)
    save_board(measures, board)
    width, height = board.size_mm
    print(
        f"{out}: {board.columns} x {board.rows} squares, {width:g} x {height:g} mm on {page}; "
        f"print at 100 %, measure the ruler, and keep {measures.name}"
    )


def calibrate_camera(
    source: Path | Sequence[Path] | int,
    board: Path,
    out: Path,
    *,
    most: int = FRAMES_MOST,
    warn: Tell = print,
) -> Calibration:
    """Calibrate from photographs, a video or a webcam (its number), and write the camera as JSON.

    ``warn`` gets one line for each picture dropped and each doubt.
    """
    if out.suffix.lower() != ".json":
        raise InputError(f"{out}: a camera is written as .json; choose another name")
    if most < 3:
        raise InputError(f"at least 3 frames are needed, got {most}")
    found = calibrate(read_frames(source, most=most), load_board(board))
    write_json(out, describe_calibration(found))
    for name, reason in found.dropped:
        warn(f"left out {name}: {reason}")
    for warning in found.warnings:
        warn(warning)
    lens = found.intrinsics
    print(
        f"{out}: focal length {lens.fx:.1f} x {lens.fy:.1f} px (± {found.std['fx']:.1f}), "
        f"{lens.width}x{lens.height}, {len(found.views)} pictures, corners off by "
        f"{lens.rms_px:.2f} px"
    )
    return found


def describe_calibration(calibration: Calibration) -> dict[str, object]:
    """The camera, and under "calibration" what it rests on."""
    return {
        **describe_intrinsics(calibration.intrinsics),
        "calibration": {
            "std": calibration.std,
            "tilt_spread_deg": calibration.tilt_spread_deg,
            "coverage": calibration.coverage,
            "warnings": list(calibration.warnings),
            "views": [
                {
                    "name": view.name,
                    "corners": view.corners,
                    "rms_px": view.rms_px,
                    "distance_mm": view.distance_mm,
                }
                for view in calibration.views
            ],
            "dropped": [{"name": name, "reason": reason} for name, reason in calibration.dropped],
            "version": __version__,
        },
    }


def recover_camera_response(
    photos: Sequence[Path], out: Path, *, times: str | None = None
) -> Response:
    """Recover how codes encode light from exposures of one scene, and write it as JSON.

    ``times`` lists the exposure times in the pictures' order, such as "1/60,1/30,1/15"; by default
    they are taken from the files' EXIF data.
    """
    if out.suffix.lower() != ".json":
        raise InputError(f"{out}: a response is written as .json; choose another name")
    if not photos:
        raise InputError("no pictures were given: name two or more")
    seconds = exif_exposures(photos) if times is None else exposure_times(times)
    pictures = [read_picture(path).image for path in photos]
    response = recover_response(pictures, seconds)
    save_response(out, response)
    assert response.curve is not None
    middle = ", ".join(f"{value:.3f}" for value in response.curve[:, 128])
    print(
        f"{out}: from {len(photos)} exposures, {max(seconds) / min(seconds):.3g} to 1; code 128 "
        f"stands for {middle} of the most light (sRGB 0.216)"
    )
    return response


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
