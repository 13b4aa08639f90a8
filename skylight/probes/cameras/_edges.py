"""Pose refinement on the edges of a known object.

Board corners lie beside the object and in one plane; the object's own edges constrain its pose
better. Each visible edge is sampled, the largest gradient across it is searched for, and the pose
follows by robust least squares (Drummond & Cipolla 2002, "Real-time visual tracking of complex
structures"; Harris 1990, RAPID).
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from skylight.probes.cameras._intrinsics import FLIP, FLIPPED, Intrinsics
from skylight.probes.cameras._pose import project
from skylight.sphere._rotation import RigidTransform

_SEARCH_PX = 8.0  # less than to the next edge that looks like it, where the pose allows
_SEARCH_LAST_PX = 2.5  # once near, what lies further off is another edge
_STEP_PX = 0.5  # between the places tried across an edge
_SPACING_PX = 4.0  # between samples along an edge
_ENDS = 0.08  # share of an edge left out at each end, where others meet it
_BLUR_PX = 1.0
_CONTRAST_MIN = 4.0  # codes per pixel; noise of 2 codes makes about 0.6 after the blur
_TUKEY = 4.685  # 95 % efficiency on normal errors (Holland & Welsch 1977)
_SCALE_MIN_PX = 0.15
_ROUNDS = 30
_STILL_PX = 0.01
_SAMPLES_MIN = 30
_RMS_MAX_PX = 1.5
_AGREE_MIN = 0.4  # share of the samples that must follow the pose
_CONDITION_MIN = 1e-5  # of the scaled normal matrix: less leaves a motion undetermined


@dataclass(frozen=True, kw_only=True)
class EdgeFit:
    """The refined pose, or the one given where ``converged`` is False; ``reason`` then says why.

    ``samples`` counts the inliers, ``rms_px`` is their RMS residual normal to the edges,
    ``moved_px`` how far the edges went in the picture on the whole.
    """

    pose: RigidTransform
    converged: bool
    samples: int
    rms_px: float
    moved_px: float
    reason: str = ""


def refine_on_edges(
    image: UInt8[np.ndarray, "h w 3"],
    pose: RigidTransform,
    intrinsics: Intrinsics,
    edges: Float[np.ndarray, "n 2 3"],
    visible: Bool[np.ndarray, " n"],
) -> EdgeFit:
    """The pose under which the object's edges lie on the picture's.

    ``edges``: ends of the object's straight edges in the pose's world, mm, of which the
    ``visible`` ones are used.

    Each sample p on an edge with normal n in the picture gives one residual r: how far along n,
    within the search range, the derivative of the blurred brightness is strongest. The motion m
    (rotation and translation in the camera's frame) minimises sum rho(n . dp/dm m - r) with
    Tukey's rho, whose scale is ``1.48 median |r|``; iterated to convergence with a
    shrinking search range.
    """
    intrinsics.require_size(image.shape[1], image.shape[0])
    shown = edges[visible]
    grey = blurred_grey(image)
    current, search = pose, _SEARCH_PX
    for _ in range(_ROUNDS):
        points, normals, slopes = _samples(shown, current, intrinsics)
        offsets = strongest_steps(grey, points, normals, search)
        found = np.isfinite(offsets)
        if found.sum() < _SAMPLES_MIN:
            return _kept(pose, f"only {int(found.sum())} places on edges are seen in the picture")
        miss, slope = offsets[found], slopes[found]
        weight, scale = tukey_weights(miss)
        solved = _motion(slope, miss, weight)
        if solved is None:
            return _kept(pose, "the edges that are seen leave a motion undetermined")
        current = _moved(current, solved)
        shift = float(np.sqrt((weight * (slope @ solved) ** 2).sum() / weight.sum()))
        left = miss - slope @ solved
        inliers = weight > 0
        rms, used = float(np.sqrt((left[inliers] ** 2).mean())), int(inliers.sum())
        if shift < _STILL_PX and search <= _SEARCH_LAST_PX:
            moved = _moved_px(pose, current, shown, intrinsics)
            if rms > _RMS_MAX_PX or used < max(_AGREE_MIN * len(offsets), _SAMPLES_MIN):
                return _kept(
                    pose, f"{used} of {len(offsets)} places on edges agree, to {rms:.1f} px"
                )
            if moved > 2 * _SEARCH_PX:
                return _kept(pose, f"the edges went {moved:.0f} px, further than was searched")
            return EdgeFit(pose=current, converged=True, samples=used, rms_px=rms, moved_px=moved)
        search = max(_SEARCH_LAST_PX, min(search, 0.75 * search + 0.25 * 6 * scale))
    return _kept(pose, f"the edges did not come to rest within {_ROUNDS} rounds")


def blurred_grey(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    """Brightness in codes, in which steps are sought."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return cv2.GaussianBlur(grey, (0, 0), _BLUR_PX)


def _kept(pose: RigidTransform, reason: str) -> EdgeFit:
    return EdgeFit(
        pose=pose, converged=False, samples=0, rms_px=float("inf"), moved_px=0.0, reason=reason
    )


def _moved_px(
    before: RigidTransform,
    after: RigidTransform,
    edges: Float[np.ndarray, "n 2 3"],
    intrinsics: Intrinsics,
) -> float:
    """How far the edges' ends went in the picture, root mean square."""
    ends = edges.reshape(-1, 3)
    moved = project(ends, after, intrinsics) - project(ends, before, intrinsics)
    return float(np.sqrt((moved**2).sum(1).mean()))


def _samples(
    edges: Float[np.ndarray, "n 2 3"], pose: RigidTransform, intrinsics: Intrinsics
) -> tuple[Float[np.ndarray, "s 2"], Float[np.ndarray, "s 2"], Float[np.ndarray, "s 6"]]:
    """Places along the edges in the picture, normals there, and d(place . normal) / d(motion)."""
    ends = pose.points(edges.reshape(-1, 3)) @ FLIP
    before = (ends.reshape(-1, 2, 3)[..., 2] > 1e-6).all(1)  # an end behind the camera has no place
    ends = ends.reshape(-1, 2, 3)[before]
    places = intrinsics.project(ends.reshape(-1, 3)).reshape(-1, 2, 2)
    points, along = [], []
    for (a, b), (pa, pb) in zip(ends, places, strict=True):
        count = min(int(np.linalg.norm(pb - pa) * (1 - 2 * _ENDS) / _SPACING_PX), 1000)
        if count >= 1:
            share = _ENDS + (1 - 2 * _ENDS) * (np.arange(count) + 0.5) / count
            points.append(a + share[:, None] * (b - a))
            along.append(np.broadcast_to(b - a, (count, 3)))
    if not points:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 6))
    pixels, normal, slopes = across_edges(np.concatenate(points), np.concatenate(along), intrinsics)
    return pixels, normal, np.einsum("si,sij->sj", normal, slopes)


def across_edges(
    places: Float[np.ndarray, "s 3"], along: Float[np.ndarray, "s 3"], intrinsics: Intrinsics
) -> tuple[Float[np.ndarray, "s 2"], Float[np.ndarray, "s 2"], Float[np.ndarray, "s 2 6"]]:
    """(pixels, normals there of edges that go ``along``, d(pixel) / d(motion)) of places on edges.

    In OpenCV's camera frame. Motions 0-2 turn about the camera, 3-5 shift.
    """
    still = np.zeros(3)
    pixels, slopes = cv2.projectPoints(
        places, still, still, intrinsics.matrix, intrinsics.distortion
    )
    slopes = slopes[:, :6].reshape(-1, 2, 6)
    # shifting also gives the edge's direction
    tangent = np.einsum("sij,sj->si", slopes[:, :, 3:], along)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-12
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], 1)
    return pixels.reshape(-1, 2), normal, slopes


def strongest_steps(
    grey: Float[np.ndarray, "h w"],
    points: Float[np.ndarray, "s 2"],
    normals: Float[np.ndarray, "s 2"],
    search: float,
    *,
    rising: bool = False,
) -> Float[np.ndarray, " s"]:
    """How far along its normal each place has the strongest step; NaN without a clear one.

    With ``rising``, of the steps alone that get brighter along the normal.
    """
    if not len(points):
        return np.zeros(0)
    reach = int(np.ceil(search / _STEP_PX)) + 1  # one more at both ends to tell a peak by
    offsets = _STEP_PX * np.arange(-reach - 1, reach + 2)
    at = points[:, None] + offsets[:, None] * normals[:, None]
    height, width = grey.shape
    inside = ((at >= 0) & (at <= [width - 1, height - 1])).all((1, 2))
    values = cv2.remap(
        grey,
        at[..., 0].astype(np.float32),
        at[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    steps = (values[:, 2:] - values[:, :-2]) / (2 * _STEP_PX)
    steps = steps if rising else np.abs(steps)
    best = 1 + steps[:, 1:-1].argmax(1)
    row = np.arange(len(points))
    left, peak, right = steps[row, best - 1], steps[row, best], steps[row, best + 1]
    is_peak = (peak >= left) & (peak >= right) & (peak >= _CONTRAST_MIN)
    bend = np.where(is_peak, left - 2 * peak + right, -1.0)
    finer = 0.5 * (left - right) / np.minimum(bend, -1e-6)  # a parabola's top
    out = offsets[1:-1][best] + _STEP_PX * np.clip(finer, -1, 1)
    return np.where(is_peak & inside, out, np.nan).astype(np.float64)


def tukey_weights(miss: Float[np.ndarray, " s"]) -> tuple[Float[np.ndarray, " s"], float]:
    """(1 - (r / c)^2)^2 within c = 4.685 scale, about the median; and the scale.

    About the median of ``|r|``, not of r: normals of neighbouring edges point either way.
    """
    scale = max(1.4826 * float(np.median(np.abs(miss))), _SCALE_MIN_PX)
    share = np.clip(np.abs(miss) / (_TUKEY * scale), 0, 1)
    return (1 - share**2) ** 2, scale


def _motion(
    slope: Float[np.ndarray, "s 6"], miss: Float[np.ndarray, " s"], weight: Float[np.ndarray, " s"]
) -> Float[np.ndarray, "6"] | None:
    """Weighted least squares; None where a motion is not determined."""
    size = np.sqrt((weight[:, None] * slope**2).sum(0)) + 1e-30
    scaled = slope / size
    normal = scaled.T @ (weight[:, None] * scaled)
    values = np.linalg.eigvalsh(normal)
    if not values[0] > _CONDITION_MIN * values[-1]:
        return None
    return np.linalg.solve(normal, scaled.T @ (weight * miss)) / size


def _moved(pose: RigidTransform, motion: Float[np.ndarray, "6"]) -> RigidTransform:
    """The pose after a motion in OpenCV's camera frame."""
    return FLIPPED @ RigidTransform.from_vector(torch.from_numpy(motion)) @ FLIPPED @ pose
