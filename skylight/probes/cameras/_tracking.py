"""A board followed through a film: corners found from those of the frame before.

Searching whole frames for markers takes several times as long. Nothing is taken on trust from the
frame before: corners are refined where this frame shows them, as in detection, and count where both
markers beside them are read as printed. Errors cannot add up, and another view is noticed.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from skylight.probes.cameras._board import Board
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._pose import (
    CORNERS_MIN,
    BoardCorners,
    BoardPose,
    as_grey,
    corners_pose,
    grey_corners,
    project,
    spread_out,
)

_WINDOW_PX, _LEVELS = (21, 21), 3  # of the optical flow
_FLOW_OFF_PX = 3.0  # what flows elsewhere than the plane by more is not the board
_OFF_PX, _RMS_PX = 1.5, 1.0  # of a refined corner from the plane, and of all from the pose's
_REFINE_PX = 2, 10  # half of the windows in which corners are refined: clear of markers, if it can
_REFINE_UNTIL = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 0.01)
_READ = 0.7  # correlation of what is seen with what was printed
_CONTRAST = 4.0  # codes, standard deviation


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """A frame, where it has the corners of the board, all of them, and how they moved; px."""

    grey: UInt8[np.ndarray, "h w"]
    pixels: Float[np.ndarray, "c 2"]
    motion: Float[np.ndarray, "c 2"]


class _Print:
    """Groups of places on the board, and which of them are printed black."""

    def __init__(self, places: Float[np.ndarray, "m k 3"], dark: Bool[np.ndarray, "m k"]) -> None:
        self.places, self.dark = places, dark
        pattern = np.where(dark, -1.0, 1.0)
        pattern -= pattern.mean(1, keepdims=True)
        self.pattern: Float[np.ndarray, "m k"] = pattern / pattern.std(1, keepdims=True)


class BoardTracker:
    """Poses of a board in the frames of a film, one after the other.

    Corners are followed by optical flow (Lucas & Kanade 1981, in pyramids as by Bouguet 2001),
    starting with their last motion. The homography of the board's plane on which most agree
    (Fischler & Bolles 1981) tells where every corner and marker must be. Corners are refined there,
    and kept where they agree with the homography and their squares and both markers look as
    printed, so that what is hidden drops out and comes back. Frames are searched as a whole at
    first, and whenever too few corners are left or the reprojection error exceeds 1 px.
    """

    def __init__(self, board: Board, intrinsics: Intrinsics) -> None:
        self._board, self._intrinsics = board, intrinsics
        self._points = board.corners()
        cells, dark = board.marker_cells()
        side = cells.shape[1]
        self._cells = _Print(cells.reshape(len(cells), -1, 3), dark.reshape(len(dark), -1))
        rims = cells[:, [0, 0, -1, -1], [0, -1, 0, -1]]
        middles = rims.mean(1, keepdims=True)
        rims = middles + (rims - middles) * side / (side - 1)  # from cells' middles to corners
        apart = np.linalg.norm(self._points[:, None, None] - rims, axis=3)
        # a corner is where two white squares meet: their markers, and the corners turned to it
        self._markers: Int[np.ndarray, "c 2"] = np.argsort(apart.min(2), axis=1)[:, :2]
        nearest = np.take_along_axis(apart.argmin(2), self._markers, axis=1)
        self._marker_corners: Float[np.ndarray, "c 2 3"] = rims[self._markers, nearest]
        self._squares = _Print(*_squares_round(self._points, self._marker_corners))
        self._last: _Seen | None = None
        self.searched = 0
        """Frames that were searched as a whole."""

    def pose(self, image: UInt8[np.ndarray, "h w 3"]) -> BoardPose | None:
        """The pose of the board's frame in the film's next picture; None without the board.

        Raises
        ------
        InputError
            A picture of another size than that which the camera was calibrated for.
        """
        self._intrinsics.require_size(image.shape[1], image.shape[0])
        grey, last = as_grey(image), self._last
        found = None if last is None else self._followed(grey, last)
        if found is None:
            last = None
            found = self._searched(grey)
        self._last = None
        if found is not None:
            pixels = project(self._points, found.pose, self._intrinsics)
            motion = np.zeros_like(pixels) if last is None else pixels - last.pixels
            self._last = _Seen(grey=grey, pixels=pixels, motion=motion)
        return found

    def _searched(self, grey: UInt8[np.ndarray, "h w"]) -> BoardPose | None:
        """The pose from a search of the whole frame."""
        self.searched += 1
        corners = grey_corners(grey, self._board)
        if corners is None:
            return None
        plane, _ = self._plane(corners.numbers, corners.pixels, _OFF_PX)
        found = None if plane is None else self._pose_near(grey, plane)
        return found or corners_pose(corners, self._intrinsics)

    def _followed(self, grey: UInt8[np.ndarray, "h w"], last: _Seen) -> BoardPose | None:
        """The pose from the frame before; None where the board is lost."""
        numbers = np.flatnonzero(self._inside(last.pixels))
        if len(numbers) < CORNERS_MIN:
            return None
        start = last.pixels[numbers].astype(np.float32)
        flowed, there, _ = cv2.calcOpticalFlowPyrLK(
            last.grey,
            grey,
            start,
            start + last.motion[numbers].astype(np.float32),
            winSize=_WINDOW_PX,
            maxLevel=_LEVELS,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        there = there.ravel() == 1
        plane, _ = self._plane(numbers[there], flowed[there], _FLOW_OFF_PX)
        return None if plane is None else self._pose_near(grey, plane)

    def _pose_near(
        self, grey: UInt8[np.ndarray, "h w"], plane: Float[np.ndarray, "3 3"]
    ) -> BoardPose | None:
        """The pose near a homography, from all corners that are there; None where they are not."""
        numbers, pixels = self._refined(grey, plane)
        closer, _ = self._plane(numbers, pixels, _OFF_PX)
        if closer is None:
            return None
        # windows are small: from closer by, they see more of their corners
        numbers, pixels = self._refined(grey, closer)
        closer, agree = self._plane(numbers, pixels, _OFF_PX)
        if closer is None:
            return None
        kept = agree & self._read(grey, closer, self._squares)[numbers]
        kept &= self._read(grey, closer, self._cells)[self._markers[numbers]].all(1)
        numbers, pixels = numbers[kept], pixels[kept].astype(np.float64)
        if not spread_out(self._points[numbers], self._board):
            return None
        corners = BoardCorners(numbers=numbers, pixels=pixels, points=self._points[numbers])
        found = corners_pose(corners, self._intrinsics)
        return None if found is None or found.rms_px > _RMS_PX else found

    def _plane(
        self, numbers: Int[np.ndarray, " n"], pixels: Float[np.ndarray, "n 2"], off_px: float
    ) -> tuple[Float[np.ndarray, "3 3"] | None, Bool[np.ndarray, " n"]]:
        """(homography of the board's (x, z) to the picture without distortion, who agrees)."""
        if len(numbers) < CORNERS_MIN:
            return None, np.zeros(len(numbers), bool)
        ideal = self._intrinsics.undistort_points(pixels)
        on_board = self._points[numbers][:, [0, 2]]
        plane, agree = cv2.findHomography(on_board, ideal, cv2.RANSAC, off_px)
        if plane is None:
            return None, np.zeros(len(numbers), bool)
        agree = agree.ravel() == 1
        depth = on_board[agree].mean(0) @ plane[2, :2] + plane[2, 2]
        return np.sign(depth) * plane, agree  # a homography's sign is free: depths are above 0

    def _at(
        self, plane: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 2"]:
        """Where points of the board are in the picture; infinite where they are not before it."""
        lens = self._intrinsics
        mapped = points[:, [0, 2]] @ plane[:, :2].T + plane[:, 2]
        ahead = mapped[:, 2] > 1e-9
        ideal = mapped[:, :2] / np.where(ahead, mapped[:, 2], 1.0)[:, None]
        rays = (ideal - [lens.cx, lens.cy]) / [lens.fx, lens.fy]
        pixels = lens.project(np.column_stack([rays, np.ones(len(rays))]))
        # distortion folds what is far outside back into the frame
        ahead &= (np.abs(ideal - [lens.cx, lens.cy]) < [lens.width, lens.height]).all(1)
        return np.where(ahead[:, None], pixels, np.inf)

    def _inside(self, pixels: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Far enough from the picture's edges to be refined a little."""
        size = np.array([self._intrinsics.width, self._intrinsics.height])
        return np.asarray(((pixels >= 2) & (pixels <= size - 3)).all(-1))

    def _refined(
        self, grey: UInt8[np.ndarray, "h w"], plane: Float[np.ndarray, "3 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """(numbers of the corners in the picture, where they are to a fraction of a pixel)."""
        expected = self._at(plane, self._points)
        numbers = np.flatnonzero(self._inside(expected))
        pixels = expected[numbers].astype(np.float32)
        beside = self._at(plane, self._marker_corners[numbers].reshape(-1, 3)).reshape(-1, 2, 2)
        room = np.abs(beside - expected[numbers, None]).max(2).min(1)
        halves = np.clip(room, *_REFINE_PX).astype(int)
        for half in np.unique(halves):
            size = int(half), int(half)
            mine = np.ascontiguousarray(pixels[halves == half])
            pixels[halves == half] = cv2.cornerSubPix(grey, mine, size, (-1, -1), _REFINE_UNTIL)
        return numbers, pixels

    def _read(
        self, grey: UInt8[np.ndarray, "h w"], plane: Float[np.ndarray, "3 3"], what: _Print
    ) -> Bool[np.ndarray, " m"]:
        """Which groups of places look as they were printed."""
        at = self._at(plane, what.places.reshape(-1, 3))
        inside = self._inside(at).reshape(what.dark.shape).all(1)
        x, y = np.where(np.isfinite(at), at, 0).astype(np.float32).T
        seen = cv2.remap(grey, x, y, cv2.INTER_LINEAR).reshape(what.dark.shape).astype(np.float64)
        seen -= seen.mean(1, keepdims=True)
        deviation = seen.std(1)
        alike = (seen * what.pattern).mean(1) / np.maximum(deviation, 1e-9)
        return np.asarray(inside & (deviation > _CONTRAST) & (alike > _READ))


def _squares_round(
    corners: Float[np.ndarray, "c 3"], marker_corners: Float[np.ndarray, "c 2 3"]
) -> tuple[Float[np.ndarray, "c 4 3"], Bool[np.ndarray, "c 4"]]:
    """(places in the four squares that meet at each corner, which are black).

    White ones are half-way to the markers, black ones as far to the other sides.
    """
    white = (marker_corners - corners[:, None]) / 2
    black = white * [-1, 1, 1]
    places = corners[:, None] + np.concatenate([white, black], 1)
    return places, np.tile([False, False, True, True], (len(corners), 1))
