"""How a camera turns while it films, by what it sees of the background.

Corners of the background are followed from frame to frame (Shi & Tomasi 1994; Lucas & Kanade 1981,
in Bouguet's pyramids). What is far away moves by the camera's turn alone: with the unit ray r(x)
through pixel x, ::

    r(before_i) = R r(after_i),

R leading from the later camera's frame to the earlier one's, by two matches at a time (RANSAC,
Fischler & Bolles 1981), then by all that agree (Kabsch 1976). A camera that is carried along sees
near things move too; they are outliers, or, where there is nothing else, taken for a turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

_SIDE = 640  # px of the pictures that corners are followed in
_CORNERS, _APART_PX, _QUALITY = 300, 8, 0.01
_WINDOW = (21, 21)
_THERE_AND_BACK_PX = 0.7  # corners that come back farther from where they were are lost
_FEWEST = 8  # matches that tell a turn
_TRIALS = 200
_AGREES_PX = 1.5
_LEAST_SHARE = 0.3  # of the matches: more than agree on a turn by accident
_MATCH_PX = 0.5  # what a match errs by,
_TOGETHER = 10.0  # and how many err together
_FOCAL_STEPS = 25


@dataclass(frozen=True, kw_only=True)
class Link:
    """Matches (n,2), px (x, y), of frame ``start`` (``before``) and a later frame ``end``."""

    start: int
    end: int
    before: Float[ndarray, "n 2"]
    after: Float[ndarray, "n 2"]


class BackgroundCorners:
    """Corners of the background since the last :meth:`anchor`, followed frame by frame."""

    def __init__(self, width: int, height: int) -> None:
        self._scale = _working_scale((width, height))
        self._size = round(width * self._scale), round(height * self._scale)
        self._grey: UInt8[ndarray, "h w"] | None = None
        self._before = self._after = np.zeros((0, 2), np.float32)
        self._first_count = 0

    def anchor(self, codes: UInt8[ndarray, "h w 3"], background: Bool[ndarray, "h w"]) -> None:
        """Look for new corners where ``background`` is seen; matches begin here."""
        self._grey = self._small_grey(codes)
        mask = cv2.resize(background.astype(np.uint8), self._size, interpolation=cv2.INTER_NEAREST)
        found = cv2.goodFeaturesToTrack(self._grey, _CORNERS, _QUALITY, _APART_PX, mask=mask)
        points = np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2)
        self._before = self._after = points.astype(np.float32)
        self._first_count = len(points)

    def follow(self, codes: UInt8[ndarray, "h w 3"], background: Bool[ndarray, "h w"]) -> float:
        """Follow the corners into the next frame; the share of them that is still there.

        Those that are lost, or meet what is no background, do not come back before the next anchor.
        """
        grey = self._small_grey(codes)
        before, self._grey = self._grey, grey
        assert before is not None
        count = len(self._after)
        if count == 0:
            return 0.0
        moved = _flow(before, grey, self._after)
        back = _flow(grey, before, moved)
        kept = np.linalg.norm(back - self._after, axis=1) < _THERE_AND_BACK_PX
        width, height = self._size
        column, row = np.floor(moved).astype(int).T
        kept &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
        mask = cv2.resize(background.astype(np.uint8), self._size, interpolation=cv2.INTER_NEAREST)
        kept[kept] = mask[row[kept], column[kept]] > 0
        self._before, self._after = self._before[kept], moved[kept]
        return float(kept.sum()) / count

    @property
    def is_worn(self) -> bool:
        """Half of the corners are lost, or the rest has moved by a quarter of the picture."""
        if len(self._after) < max(self._first_count / 2, 2 * _FEWEST):
            return True
        moved = np.linalg.norm(self._after - self._before, axis=1)
        return float(np.median(moved)) > max(self._size) / 4

    def link(self, start: int, end: int) -> Link:
        """The matches since the anchor, which was frame ``start``."""
        before, after = (p.astype(np.float64) / self._scale for p in (self._before, self._after))
        return Link(start=start, end=end, before=before, after=after)

    def _small_grey(self, codes: UInt8[ndarray, "h w 3"]) -> UInt8[ndarray, "a b"]:
        small = cv2.resize(codes, self._size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _flow(
    before: UInt8[ndarray, "h w"], after: UInt8[ndarray, "h w"], points: Float[ndarray, "n 2"]
) -> Float[ndarray, "n 2"]:
    """Where the points are in the next picture."""
    return cv2.calcOpticalFlowPyrLK(before, after, points, points.copy(), winSize=_WINDOW)[0]


def turn_between(
    link: Link, focal_px: float, size: tuple[int, int]
) -> Float[ndarray, "3 3"] | None:
    """R of the module's text, for pictures of ``size`` (width, height) px seen from their middle.

    None where too few matches agree on a turn.
    """
    agreed = _agreed_turn(link, focal_px, size)
    if agreed is None or agreed[1].mean() < _LEAST_SHARE or agreed[1].sum() < _FEWEST:
        return None
    return agreed[0]


def world_from_cameras(
    links: Sequence[Link], focal_px: float, size: tuple[int, int]
) -> tuple[dict[int, Float[ndarray, "3 3"]], list[Link]]:
    """(rotations from each frame's camera to the first one's, links that tell no turn).

    ``links`` are in order: each starts at the first frame or where an earlier one ends. Where a
    turn cannot be told the camera is taken to have stood still.
    """
    world = {links[0].start: np.eye(3)} if links else {}
    unresolved = []
    for link in links:
        turn = turn_between(link, focal_px, size)
        if turn is None:
            unresolved.append(link)
            turn = np.eye(3)
        world[link.end] = world[link.start] @ turn
    return world, unresolved


def focal_from_turns(
    links: Sequence[Link], guess_px: float, spread: float, size: tuple[int, int]
) -> tuple[float, float]:
    """(focal length in px, standard deviation of its log) by which matches agree with turns.

    Maximises the likelihood of the matches, which err by half a pixel, ten together, some of them
    by anything, times a log-normal density about ``guess_px``, of standard deviation ``spread``. A
    camera that hardly turns tells little: then these come back.
    """
    logs = np.log(guess_px) + np.linspace(-3, 3, _FOCAL_STEPS) * spread
    nats = 0.5 * ((logs - np.log(guess_px)) / spread) ** 2
    for number, log in enumerate(logs):
        nats[number] += sum(_unlikeliness(link, float(np.exp(log)), size) for link in links)
    best = int(np.clip(nats.argmin(), 1, len(logs) - 2))
    low, middle, high = nats[best - 1 : best + 2]
    step = logs[1] - logs[0]
    curve = low - 2 * middle + high
    if curve <= 0:
        return float(np.exp(logs[best])), spread
    shift = np.clip(0.5 * (low - high) / curve, -1, 1)
    return float(np.exp(logs[best] + shift * step)), float(step / np.sqrt(curve))


def _unlikeliness(link: Link, focal_px: float, size: tuple[int, int]) -> float:
    """Nats of a link's matches under the best turn, each bounded."""
    agreed = _agreed_turn(link, focal_px, size)
    if agreed is None:
        return 0.0
    error = _errors(link, agreed[0][None], focal_px, size)[0] * _working_scale(size) / _MATCH_PX
    return float(0.5 * (np.minimum(error, 3) ** 2).sum() / _TOGETHER)


def _agreed_turn(
    link: Link, focal_px: float, size: tuple[int, int]
) -> tuple[Float[ndarray, "3 3"], Bool[ndarray, " n"]] | None:
    """The turn on which most matches agree, and which do; None of too few matches."""
    count = len(link.before)
    if count < _FEWEST:
        return None
    before, after = (pinhole_rays(points, focal_px, size) for points in (link.before, link.after))
    drawn = np.random.default_rng(0).integers(count, size=(_TRIALS, 2))
    drawn = drawn[drawn[:, 0] != drawn[:, 1]]
    turns = _frames(before[drawn]) @ _frames(after[drawn]).transpose(0, 2, 1)
    limit = _AGREES_PX / _working_scale(size)
    agree = _errors(link, turns, focal_px, size) < limit
    kept, turn = agree[agree.sum(1).argmax()], np.eye(3)
    for _ in range(3):
        if kept.sum() < 2:
            return None
        turn = best_rotation(before[kept].T @ after[kept])
        kept = _errors(link, turn[None], focal_px, size)[0] < limit
    return turn, kept


def _errors(
    link: Link, turns: Float[ndarray, "t 3 3"], focal_px: float, size: tuple[int, int]
) -> Float[ndarray, "t n"]:
    """Pixels between where each match was and where the turned ray of where it is leads."""
    back = np.einsum("tij,nj->tni", turns, pinhole_rays(link.after, focal_px, size))
    ahead = np.maximum(-back[..., 2], 1e-6)
    seen = focal_px * np.stack([back[..., 0], -back[..., 1]], 2) / ahead[..., None]
    return np.linalg.norm(seen + np.array(size) / 2 - link.before, axis=2)


def pinhole_rays(
    points: Float[ndarray, "n 2"], focal_px: float, size: tuple[int, int]
) -> Float[ndarray, "n 3"]:
    """Unit; the camera looks along -Z, +X is the picture's right, +Y up."""
    x, y = (points - np.array(size) / 2).T
    rays = np.stack([x, -y, np.full_like(x, -focal_px)], 1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _frames(pairs: Float[ndarray, "t 2 3"]) -> Float[ndarray, "t 3 3"]:
    """Orthonormal frames (columns) that pairs of rays span."""
    first, second = pairs[:, 0], pairs[:, 1]
    across = np.cross(first, second)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    return np.stack([first, across, np.cross(first, across)], 2)


def best_rotation(cross: Float[ndarray, "3 3"]) -> Float[ndarray, "3 3"]:
    """The rotation R of greatest tr(R^T C) (Kabsch 1976).

    Of C = A^T B, rows of A and B being vectors, it leads those of B to those of A best, by least
    squares.
    """
    left, _, right = np.linalg.svd(cross)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return left @ mirror @ right


def _working_scale(size: tuple[int, int]) -> float:
    """Pixels of the pictures that corners are followed in, per pixel of the film."""
    return min(1.0, _SIDE / max(size))
