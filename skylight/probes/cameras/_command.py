"""``skylight camera``: boards to print, lenses and responses."""

from pathlib import Path

import tyro
from tyro.conf import Positional

from skylight._names import Page
from skylight._options import one_source, take_care

camera = tyro.extras.SubcommandApp()


@camera.command(name="board")
def camera_board(
    out: Positional[Path] = Path("board.pdf"),
    columns: int = 7,
    rows: int = 10,
    square_mm: float = 25.0,
    marker_mm: float | None = None,
    page: Page = "A4",
    dictionary: str = "DICT_4X4_50",
    first_marker: int = 0,
) -> None:
    """Draw a board to calibrate a camera with, to be printed at 100 %.

    Beside OUT, a .json file of the same name holds the board's measures; calibration reads it.

    Args:
        out: The page to write: .pdf or .svg.
        columns: Squares from left to right.
        rows: Squares from top to bottom.
        square_mm: Side of a square.
        marker_mm: Side of a marker; by default 0.72 of a square's.
        page: Paper; a board wider than high is laid across.
        dictionary: OpenCV's name of the set of markers.
        first_marker: Number of the first marker; boards with other numbers can be told apart.
    """
    from skylight.probes.cameras._board import Board
    from skylight.probes.cameras._files import make_board

    board = Board(
        columns=columns,
        rows=rows,
        square_mm=square_mm,
        marker_mm=0.72 * square_mm if marker_mm is None else marker_mm,
        dictionary=dictionary,
        first_marker=first_marker,
    )
    make_board(out, board, page=page)


@camera.command(name="calibrate")
def camera_calibrate(
    photos: Positional[tuple[Path, ...]] = (),
    video: Path | None = None,
    webcam: int | None = None,
    board: Path = Path("board.json"),
    out: Path = Path("camera.json"),
    frames: int = 40,
) -> None:
    """Find a camera's focal length and distortion from pictures of a board.

    Take 10 to 20 pictures with focus and zoom fixed: the board tilted by 20 to 40 degrees, each
    time another way, and also in the picture's corners. The same settings hold for the pictures
    that are measured later.

    Args:
        photos: Pictures of the board: JPEG, PNG, TIFF or HEIC, all of one size.
        video: Instead of photos, a video; its sharp and different frames are used.
        webcam: Instead of photos, the number of a webcam, watched for 20 seconds.
        board: The board's measures, as `skylight camera board` wrote them.
        out: The .json file.
        frames: Most frames to use of a video or webcam.
    """
    source = one_source(photos, video, webcam)
    from skylight.probes.cameras._files import calibrate_camera

    calibrate_camera(source, board, out, most=frames, warn=take_care)


@camera.command(name="response")
def camera_response(
    photos: Positional[tuple[Path, ...]],
    times: str | None = None,
    out: Path = Path("response.json"),
) -> None:
    """Find how a camera's values encode light, from several exposures of one scene.

    Keep the camera, the scene and its light still, and aperture, ISO and white balance fixed; five
    exposures from too dark to too bright do well.

    Args:
        photos: The exposures: JPEG, PNG or TIFF of 8 bits, all of one size.
        times: Exposure times in their order, such as 1/60,1/30,1/15; by default those in the
            files' EXIF data.
        out: The .json file.
    """
    from skylight.probes.cameras._files import recover_camera_response

    recover_camera_response(photos, out, times=times)
