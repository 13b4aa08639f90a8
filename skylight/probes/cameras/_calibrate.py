"""Camera intrinsics from pictures of a board, with their uncertainty.

Zhang 2000, "A flexible new technique for camera calibration"; the least squares are OpenCV's.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from skylight.errors import InputError
from skylight.probes.cameras._board import Board
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._live import Frame
from skylight.probes.cameras._pose import BoardCorners, find_corners

VIEWS_MIN, VIEWS_GOOD = 3, 5  # fewer are refused; fewer are warned about
TILT_SPREAD_GOOD_DEG = 10.0
COVERAGE_GOOD = 0.5
FOCAL_STD_GOOD, FOCAL_STD_MAX = 0.005, 0.1  # of the focal length
RMS_GOOD_PX = 1.0
_OUTLIER = 3.0  # times the median view's error ...
_OUTLIER_PX = 0.5  # ... and above this
_SIGNIFICANT = 3.0  # standard deviations from which k3 is believed
_GRID = (6, 8)
_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True, kw_only=True)
class View:
    """One picture that was used: the error of its corners and where the board lay.

    ``normal`` is the paper's normal in OpenCV's camera frame, towards the camera;
    ``distance_mm`` that of the corners' mean.
    """

    name: str
    corners: int
    rms_px: float
    normal: Float[np.ndarray, "3"]
    distance_mm: float


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """The camera, the views that it was estimated from, and warnings.

    ``std`` holds one standard deviation of each estimated number; ``dropped`` (picture, reason)
    of those not used; ``warnings`` sentences for the user.
    """

    intrinsics: Intrinsics
    std: dict[str, float]
    views: tuple[View, ...]
    dropped: tuple[tuple[str, str], ...]
    tilt_spread_deg: float
    coverage: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _Solution:
    intrinsics: Intrinsics
    std: dict[str, float]
    view_rms: Float[np.ndarray, " v"]
    rotations: Float[np.ndarray, "v 3 3"]
    translations: Float[np.ndarray, "v 3"]


def calibrate(pictures: Iterable[Frame], board: Board) -> Calibration:
    """The intrinsics of the camera that took these pictures of the board.

    Pictures without the board are left out, and so are those whose corners fit the camera of all
    others three times worse than the median picture's; both are named. k3 is used only where it
    differs from 0 by three standard deviations.

    Raises
    ------
    InputError
        Fewer than three usable pictures, several sizes, or views that do not constrain the focal
        length.
    """
    seen: list[tuple[str, BoardCorners]] = []
    dropped: list[tuple[str, str]] = []
    size: tuple[int, int] | None = None
    for picture in pictures:
        height, width = picture.image.shape[:2]
        size = size or (width, height)
        if (width, height) != size:
            raise InputError(
                f"{picture.name}: {width}x{height} pixels, but those before have "
                f"{size[0]}x{size[1]}; take all in one size"
            )
        corners = find_corners(picture.image, board)
        if corners is None:
            dropped.append((picture.name, "the board was not found"))
        else:
            seen.append((picture.name, corners))
    if size is None:
        raise InputError("no pictures were given: take 10 to 20 of the board")
    return calibrate_corners(seen, size, board, dropped=tuple(dropped))


def calibrate_corners(
    seen: list[tuple[str, BoardCorners]],
    size: tuple[int, int],
    board: Board,
    *,
    dropped: tuple[tuple[str, str], ...] = (),
) -> Calibration:
    """The same from corners that were found before; ``size`` is (width, height) in pixels."""
    if len(seen) < VIEWS_MIN:
        raise InputError(
            f"the board shows in {len(seen)} of {len(seen) + len(dropped)} pictures, and at least "
            f"{VIEWS_MIN} are needed: take 10 to 20 sharp ones of the whole board "
            f"({board.columns} x {board.rows} squares, {board.dictionary}), each from elsewhere"
        )
    views, out = list(seen), list(dropped)
    solution = _solve(views, size)
    while len(views) > VIEWS_MIN:
        worst = int(solution.view_rms.argmax())
        error, usual = solution.view_rms[worst], float(np.median(solution.view_rms))
        if error < max(_OUTLIER * usual, _OUTLIER_PX):
            break
        name, _ = views.pop(worst)
        out.append((name, f"its corners are off by {error:.2g} px, others by {usual:.2g} px"))
        solution = _solve(views, size)
    normals = -solution.rotations[:, :, 2]  # OpenCV's board has its z into the paper
    spread = _widest_angle_deg(normals)
    coverage = _coverage([corners for _, corners in views], size)
    focal_std = max(
        solution.std["fx"] / solution.intrinsics.fx, solution.std["fy"] / solution.intrinsics.fy
    )
    if not focal_std < FOCAL_STD_MAX:
        raise InputError(
            f"the views differ too little to tell the focal length (it may be off by "
            f"{100 * focal_std:.0f} %): tilt the board against the camera by 20 to 40 degrees, "
            "each time another way"
        )
    described = tuple(
        View(
            name=name,
            corners=len(corners),
            rms_px=float(rms),
            normal=normal,
            distance_mm=float(np.linalg.norm(rotation @ _as_opencv(corners).mean(0) + translation)),
        )
        for (name, corners), rms, normal, rotation, translation in zip(
            views,
            solution.view_rms,
            normals,
            solution.rotations,
            solution.translations,
            strict=True,
        )
    )
    return Calibration(
        intrinsics=solution.intrinsics,
        std=solution.std,
        views=described,
        dropped=tuple(out),
        tilt_spread_deg=spread,
        coverage=coverage,
        warnings=_warnings(len(views), spread, coverage, focal_std, solution.intrinsics.rms_px),
    )


def _warnings(
    views: int, spread_deg: float, coverage: float, focal_std: float, rms_px: float
) -> tuple[str, ...]:
    """What the user should do better."""
    out = []
    if views < VIEWS_GOOD:
        out.append(f"only {views} pictures were used: take 10 to 20")
    if spread_deg < TILT_SPREAD_GOOD_DEG:
        out.append(
            f"the board's tilts are within {spread_deg:.0f} degrees, which hardly tells the focal "
            "length: tilt it by 20 to 40 degrees, each time another way"
        )
    if coverage < COVERAGE_GOOD:
        out.append(
            f"the board reached {100 * coverage:.0f} % of the picture, so distortion elsewhere is "
            "a guess: bring it into the corners as well"
        )
    if focal_std > FOCAL_STD_GOOD:
        out.append(f"the focal length is uncertain by {100 * focal_std:.1f} %: take more pictures")
    if rms_px > RMS_GOOD_PX:
        out.append(
            f"corners are off by {rms_px:.1f} px: see that the print is flat, focus and zoom are "
            "fixed and the pictures sharp"
        )
    return tuple(out)


def _solve(views: list[tuple[str, BoardCorners]], size: tuple[int, int]) -> _Solution:
    """Least squares over all views; without k3 where it is not told apart from 0."""
    first = _solve_with(views, size, 0)
    if abs(first.intrinsics.k3) >= _SIGNIFICANT * first.std["k3"]:
        return first
    return _solve_with(views, size, cv2.CALIB_FIX_K3)


def _solve_with(
    views: list[tuple[str, BoardCorners]], size: tuple[int, int], flags: int
) -> _Solution:
    points = [_as_opencv(corners).astype(np.float32) for _, corners in views]
    pixels = [corners.pixels.astype(np.float32) for _, corners in views]
    try:
        rms, matrix, distortion, turns, shifts, std, _, view_rms = cv2.calibrateCameraExtended(
            points, pixels, size, np.eye(3), np.zeros(5), flags=flags
        )
        lens = dict(zip(_PARAMETERS[4:], map(float, np.ravel(distortion)), strict=False))
        intrinsics = Intrinsics(
            width=size[0],
            height=size[1],
            fx=float(matrix[0, 0]),
            fy=float(matrix[1, 1]),
            cx=float(matrix[0, 2]),
            cy=float(matrix[1, 2]),
            rms_px=float(rms),
            **lens,
        )
    except (cv2.error, InputError) as error:
        raise InputError(
            "no camera explains these views: tilt the board by 20 to 40 degrees, each time another "
            "way, and see that the board file is that of the printed board"
        ) from error
    return _Solution(
        intrinsics=intrinsics,
        std=dict(zip(_PARAMETERS, map(float, np.ravel(std)), strict=False)),
        view_rms=np.ravel(view_rms).astype(np.float64),
        rotations=np.stack([cv2.Rodrigues(turn)[0] for turn in turns]).astype(np.float64),
        translations=np.stack([np.ravel(shift) for shift in shifts]).astype(np.float64),
    )


def _as_opencv(corners: BoardCorners) -> Float[np.ndarray, "n 3"]:
    """Points of the board's frame in OpenCV's: x right, y down the paper, z into it."""
    x, y, z = corners.points.T
    return np.stack([x, z, -y], 1)


def _widest_angle_deg(normals: Float[np.ndarray, "n 3"]) -> float:
    """Largest angle between two of the normals."""
    cosine = np.clip(normals @ normals.T, -1, 1).min()
    return float(np.degrees(np.arccos(cosine)))


def _coverage(views: list[BoardCorners], size: tuple[int, int]) -> float:
    """Share of the cells of a 6 x 8 grid over the picture in which a corner was seen."""
    rows, columns = _GRID
    pixels = np.concatenate([view.pixels for view in views])
    x = np.clip(pixels[:, 0] / size[0] * columns, 0, columns - 1).astype(int)
    y = np.clip(pixels[:, 1] / size[1] * rows, 0, rows - 1).astype(int)
    return len(set(zip(x.tolist(), y.tolist(), strict=True))) / (rows * columns)
