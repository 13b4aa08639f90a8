"""Camera calibration: boards to print, intrinsics and response curves; files to files."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import ExifTags

from skylight import __version__
from skylight.cameras.board import Board, Page, load_board, save_board, write_board
from skylight.cameras.calibrate import Calibration, calibrate
from skylight.cameras.frames import FRAMES_MOST, read_frames, read_picture
from skylight.cameras.intrinsics import describe_intrinsics
from skylight.cameras.response import Response, recover_response, save_response
from skylight.errors import InputError
from skylight.imaging.photo import read_exif
from skylight.io.json_files import write_json
from skylight.work.progress import Tell

_FIXED = (ExifTags.Base.FNumber, ExifTags.Base.ISOSpeedRatings)


@dataclass(frozen=True, kw_only=True)
class MadeBoard:
    """The page to print and the file of the board's measures."""

    page: Path
    measures: Path


def make_board(out: Path, board: Board, *, page: Page = "A4", tell: Tell = print) -> MadeBoard:
    """Draw a board on a page (.pdf or .svg) and write its measures beside it, as .json.

    Raises
    ------
    InputError
        Another ending, or the board does not fit on the page.
    """
    measures = out.with_suffix(".json")
    write_board(out, board, page)
    save_board(measures, board)
    width, height = board.size_mm
    tell(
        f"{out}: {board.columns} x {board.rows} squares, {width:g} x {height:g} mm on {page}; "
        f"print at 100 %, measure the ruler, and keep {measures.name}"
    )
    return MadeBoard(page=out, measures=measures)


def calibrate_camera(
    source: Path | Sequence[Path] | int,
    board: Path,
    out: Path,
    *,
    most: int = FRAMES_MOST,
    tell: Tell = print,
    warn: Tell = print,
) -> Calibration:
    """Calibrate from photographs, a video or a webcam (its number), and write the camera as JSON.

    ``tell`` gets the summary's line, ``warn`` one line for each picture dropped and each doubt.

    Raises
    ------
    InputError
        A file cannot be used, or the pictures do not suffice; nothing is written.
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
    tell(
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
    photos: Sequence[Path],
    out: Path,
    *,
    times: str | None = None,
    tell: Tell = print,
) -> Response:
    """Recover how codes encode light from exposures of one scene, and write it as JSON.

    ``times`` lists the exposure times in the pictures' order, such as "1/60,1/30,1/15"; by default
    they are taken from the files' EXIF data.

    Raises
    ------
    InputError
        A file cannot be used, a time is missing, or the pictures do not suffice.
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
    tell(
        f"{out}: from {len(photos)} exposures, {max(seconds) / min(seconds):.3g} to 1; code 128 "
        f"stands for {middle} of the most light (sRGB 0.216)"
    )
    return response


def exposure_times(text: str) -> list[float]:
    """Seconds of a list such as "1/60,0.5,2".

    Raises
    ------
    InputError
        A part is no number, or not finite and above 0.
    """
    out = []
    for part in text.split(","):
        above, _, below = part.partition("/")
        try:
            value = float(above) / float(below or 1)
        except (ValueError, ZeroDivisionError):
            raise InputError(
                f"exposure times must be a list such as 1/60,1/30,0.5, got {text!r}"
            ) from None
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"exposure times must be above 0, got {part.strip()} in {text!r}")
        out.append(value)
    return out


def exif_exposures(paths: Sequence[Path]) -> list[float]:
    """Exposure times in seconds that the pictures' EXIF data tell.

    Raises
    ------
    InputError
        One of them tells none or cannot be read, or aperture or sensitivity differ.
    """
    seconds, settings = [], []
    for path in paths:
        tags = read_exif(path).get_ifd(ExifTags.IFD.Exif)
        seconds.append(float(tags.get(ExifTags.Base.ExposureTime, 0)))
        settings.append([tags.get(tag) for tag in _FIXED])
        if not seconds[-1] > 0:
            raise InputError(f"{path}: its EXIF data tell no exposure time; give --times")
        if settings[-1] != settings[0]:
            raise InputError(
                f"{path}: its aperture or ISO is not that of {paths[0]}: fix both and vary the time"
            )
    return seconds
