"""Rays of pinhole cameras and lenses, and compositing into a photograph."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn.functional import normalize

from skylight.probes.cameras._intrinsics import FLIP, Intrinsics
from skylight.probes.cameras._pose import project
from skylight.probes.cameras._response import Response
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import Camera

_BORDER = 17  # places looked at along each edge of a picture
_BENT_PX = 4  # by which distortion bends an edge between two of the places looked at
Window = tuple[slice, slice]  # rows and columns of a picture
WHOLE: Window = (slice(None), slice(None))
NOWHERE: Window = (slice(0, 0), slice(0, 0))
UNSEEN = 1 / 150  # share of its light by which a pixel changes by less than one sRGB code


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """What a camera sees: ``alpha``, the share covered, and linear ``radiance`` times it."""

    radiance: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"]


def camera_rays(camera: Camera, samples: int = 1) -> Float[Tensor, "h w s 3"]:
    """Unit directions in the camera's frame through ``samples`` x ``samples`` places of a pixel."""
    height, width = camera.height, camera.width
    fine = Camera(
        focal_px=camera.focal_px * samples,
        width=width * samples,
        height=height * samples,
        center_px=(camera.center_px[0] * samples, camera.center_px[1] * samples),
    )
    rays = fine.rays().reshape(height, samples, width, samples, 3)
    return rays.transpose(1, 2).reshape(height, width, samples**2, 3)


def lens_rays(
    intrinsics: Intrinsics, samples: int = 1, window: Window | None = None
) -> Float[Tensor, "h w s 3"]:
    """The same for a real camera's own picture, distortion and all, or for a window of it."""
    rows, columns = window or (slice(0, intrinsics.height), slice(0, intrinsics.width))
    offset = (np.arange(samples) + 0.5) / samples - 0.5
    row = np.arange(rows.start, rows.stop)[:, None, None, None] + offset[:, None]
    column = np.arange(columns.start, columns.stop)[:, None, None] + offset
    row, column = np.broadcast_arrays(row, column)  # (h, w, samples, samples)
    pixels = np.stack([column, row], -1).reshape(-1, 2).astype(np.float64)
    ideal = intrinsics.undistort_points(pixels)
    x = (ideal[:, 0] - intrinsics.cx) / intrinsics.fx
    y = (ideal[:, 1] - intrinsics.cy) / intrinsics.fy
    rays = torch.from_numpy(np.stack([x, y, np.ones_like(x)], 1) @ FLIP)
    return normalize(rays, dim=1).reshape(*row.shape[:2], samples**2, 3)


def window_of(
    points: Float[np.ndarray, "n 3"], pose: RigidTransform, intrinsics: Intrinsics
) -> Window:
    """The rectangle of a camera's picture in which all points and what is between them are seen.

    The points, in the world, are close together along edges: see :func:`box_edges`. ``NOWHERE``
    where all of them are beyond the same edge of the picture.
    """
    if _beyond(points, pose, intrinsics):
        return NOWHERE
    height, width = intrinsics.height, intrinsics.width
    ahead = -pose.points(points)[:, 2]
    pixels = project(points, pose, intrinsics)
    # what is beside or behind the camera, or far outside, has no place in the picture to go by
    if ahead.min() <= 0 or np.abs(pixels - [width / 2, height / 2]).max() > 2 * width:
        return slice(0, height), slice(0, width)
    low = np.floor(pixels.min(0)).astype(int) - _BENT_PX
    high = np.ceil(pixels.max(0)).astype(int) + _BENT_PX + 1
    (left, top), (right, bottom) = low.clip(0), high.clip(0)
    return slice(min(top, height), min(bottom, height)), slice(min(left, width), min(right, width))


def _beyond(points: Float[np.ndarray, "n 3"], pose: RigidTransform, intrinsics: Intrinsics) -> bool:
    """Whether a plane through the camera and one edge of its picture has all points outside.

    The edges are those of the picture without distortion, so that points far off can be judged, for
    which distortion means nothing.
    """
    low, high = _bounds(intrinsics)
    seen = pose.points(points) @ FLIP
    place, ahead = seen[:, :2], seen[:, 2:]
    outside = np.concatenate([place < low * ahead, place > high * ahead, ahead <= 0], 1)
    return bool(outside.all(0).any())


@lru_cache(maxsize=8)
def _bounds(intrinsics: Intrinsics) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The least and the largest X / Z and Y / Z that are in a camera's picture."""
    u, v = (np.linspace(-0.5, n - 0.5, _BORDER) for n in (intrinsics.width, intrinsics.height))
    across, down = ([np.full(_BORDER, w[i]) for i in (0, -1)] for w in (v, u))
    border = [np.stack([u, row], 1) for row in across]
    border += [np.stack([column, v], 1) for column in down]
    ideal = intrinsics.undistort_points(np.concatenate(border))
    ideal = (ideal - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
    return ideal.min(0), ideal.max(0)


def is_empty(window: Window) -> bool:
    """Whether no pixel is in a rectangle of :func:`window_of`."""
    return any(each.stop <= each.start for each in window)


def box_edges(low: Float[Tensor, "3"], high: Float[Tensor, "3"]) -> Float[Tensor, "n 3"]:
    """Places along the twelve edges of a box, 17 on each."""
    share = torch.linspace(0, 1, 17, dtype=torch.float64)
    grids = []
    for axis in range(3):
        along = [torch.tensor([0.0, 1.0], dtype=torch.float64)] * 3
        along[axis] = share
        grids.append(torch.cartesian_prod(*along))
    return low + torch.cat(grids) * (high - low)


def looking_at(eye: Float[Tensor, "3"], target: Float[Tensor, "3"]) -> RigidTransform:
    """The pose ``camera_from_world`` of a camera at ``eye`` that looks at ``target``, +Y up."""
    back = normalize(eye.double() - target.double(), dim=0)
    # straight up or down, the picture's top is -Z
    steep = abs(float(back[1])) > 1 - 1e-9
    up = torch.tensor([0.0, 0.0, -1.0] if steep else [0.0, 1.0, 0.0], dtype=torch.float64)
    right = normalize(torch.linalg.cross(up, back), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(back, right), back])
    return RigidTransform(rotation=rotation, translation=-rotation @ eye.double())


def composite(
    image: UInt8[np.ndarray, "h w 3"],
    drawing: Drawing,
    response: Response,
    window: Window = WHOLE,
) -> UInt8[np.ndarray, "h w 3"]:
    """Mixed in linear light and encoded as the camera does; other pixels keep their codes.

    The drawing is that of ``window``.
    """
    out = image.copy()
    part = out[window]
    rows, columns = np.nonzero(drawing.alpha.numpy())
    if len(rows):
        codes = part[rows, columns][None]
        behind = 1 - drawing.alpha[rows, columns, None]
        mixed = drawing.radiance[rows, columns] + behind * response.linearise(codes)[0]
        part[rows, columns] = response.encode(mixed[None])[0]
    return out


def shaded(
    image: UInt8[np.ndarray, "h w 3"],
    shade: Float[Tensor, "_ _ 3"],
    response: Response,
    window: Window = WHOLE,
) -> UInt8[np.ndarray, "h w 3"]:
    """The picture with the light in ``window`` times ``shade``; where that is 1, codes stay."""
    red, green, blue = (shade - 1).abs().unbind(2)
    changed = torch.maximum(torch.maximum(red, green), blue).numpy() > UNSEEN
    out = image.copy()
    part = out[window]
    rows, columns = np.nonzero(changed)
    if len(rows):
        light = response.linearise(part[rows, columns][None])
        part[rows, columns] = response.encode(light * shade[rows, columns])[0]
    return out
