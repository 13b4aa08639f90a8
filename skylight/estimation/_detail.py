"""The photograph's own pixels in the map of its light, and its texture round the sphere.

Inside of its view a photograph shows the light itself, in the units of the estimate: its linear
values without its edit, over the white balance. With P that picture and L the estimate without its
sun and lamps, the view is multiplied by exp(D),

    D = ln P - ln L,

where the background is known (:class:`~skylight.faces._background.BackgroundPixels`): those are the
photograph's pixels. Where their mean is off beyond doubt (:func:`trust_in`; a wall at one metre, a
backdrop), they have the estimate's level, by one gain for all channels: a tint that is taken away
leaves its complement wherever the view has none. Where a pixel is clipped D is a lower bound, 0 at
least. Behind the person and beyond the picture's edges D goes on smoothly, as means over
neighbourhoods of growing size, and fades (:func:`continued`).

``mirrored`` multiplies what the photograph does not show by its fine texture
(:func:`surrounding_texture`): above the horizon that of what is above it, below of what is below.

The light does not change: the map is multiplied by ``exp(sum_k c_k Y_k)``, the less the farther
within the view (:data:`FREE_RAD`, so that there is no seam), with the c by which its harmonics are
the estimate's, of degrees 0 to 2, and of 4 as well where irradiance is off by :data:`MOST_OFF` else
(Ramamoorthi and Hanrahan 2001). Where that takes too much, there is less detail.
"""

import math
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from skylight._names import DetailName
from skylight.estimation._lights import lights_apart
from skylight.faces._background import BackgroundPixels
from skylight.imaging._edits import UNEDITED, Edit
from skylight.inverse._result import Estimate
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap, averaged, bilinear
from skylight.sphere._frame import (
    DirectionGrid,
    angles_from_direction,
    direction_from_angles,
    pixel_from_direction,
)
from skylight.transport._cameras import Camera

PIXEL_RAD = math.radians(0.35)  # of the view, at least: half a pixel of the map
FEATHER_RAD = math.radians(1.2)  # at the person and at the picture's edges
# Standard deviations of the means by which D goes on, and how much no change weighs in each
CONTINUED_RAD = tuple(math.radians(angle) for angle in (6.0, 3.0, 1.5))
LEAST_SEEN = 0.03
DOUBT = 0.7  # nats between the means of a view and an estimate, where each is believed by half
MOST_DETAIL = 3.0  # nats: a black pixel tells no more
FLOOR = 3e-4  # of the picture's white: one code of eight bits
SOLVED_ROWS = 64
# Texture: what is coarser is none; how much it is enlarged, as the sphere is larger than a view;
# how far above and below the view it is gone; and its contrast, in nats
TEXTURE_RAD, ENLARGED, FADE_RAD, MOST_TEXTURE = math.radians(4.0), 3.0, math.radians(40.0), 0.4
FREE_RAD = math.radians(8.0)  # standard deviation of the edge of what takes the light back
MOST_OFF = 0.008  # of irradiance, anywhere
MOST_CHANGE = math.log(2.0)  # anywhere, to keep the light as it was


def detailed(
    estimate: Estimate, behind: BackgroundPixels, grey: bool, detail: DetailName
) -> EnvironmentMap:
    """The estimate's map with the photograph in it, ``grey`` or in colours.

    Irradiance is the estimate's for every normal, to 1 % (tested).
    """
    if detail == "none":
        return estimate.environment
    view = View.of(behind, estimate.white_balance.numpy(), grey, estimate.faces[0].edit)
    rest, _ = lights_apart(estimate)
    lights = (estimate.environment.radiance - rest.radiance).clamp(min=0)
    base = rest.radiance.double().numpy().clip(1e-6 * float(rest.radiance.mean()) + 1e-12)
    towards = rest.grid.directions.reshape(base.shape)
    (ratio, trust), inside = view.against(base), Sampling.of_view(view, towards)
    seen = inside.feather * inside(view.known)
    shown = inside.feather[..., None] * inside(ratio * view.known[..., None])
    change = continued(shown, seen, trust)
    if detail == "mirrored":  # where the person stood too
        change += (1 - seen)[..., None] * surrounding_texture(ratio, view, base.shape[:2])
    white = inside.clipped > 0.5
    change[white] = change[white].clip(0)
    free = 1 - _blurred(inside.feather, FREE_RAD * len(base) / math.pi)
    for share, degree in product((1.0, 0.7, 0.5, 0.3, 0.1), (2, 4)):
        light = base * np.exp(share * change)
        gain = gain_back_to(base, light, free, degree)
        light *= gain
        off = irradiances(light) / irradiances(base) - 1
        if np.abs(np.log(gain)).max() < MOST_CHANGE and np.abs(off).max() < MOST_OFF:
            return EnvironmentMap(radiance=torch.from_numpy(light).to(lights) + lights)
    return estimate.environment


def irradiances(light: Float[ndarray, "r c 3"]) -> Float[ndarray, "n 3"]:
    """Of a map, on surfaces that face every way."""
    grid = DirectionGrid.latlong(SOLVED_ROWS // 2)
    normals = DirectionGrid.latlong(8).directions
    facing = (normals @ grid.directions.T).clamp(min=0) * grid.solid_angles
    coarse = averaged(torch.from_numpy(light), SOLVED_ROWS // 2).reshape(-1, 3)
    return (facing @ coarse.to(facing)).numpy()


def trust_in(mean: Float[ndarray, "3"]) -> float:
    """``1 / (1 + (max |mean| / DOUBT)^4)``: how far a view is believed whose D has that mean."""
    return 1 / (1 + (float(np.abs(mean).max()) / DOUBT) ** 4)


def continued(
    shown: Float[ndarray, "r c 3"], seen: Float[ndarray, "r c"], trust: float
) -> Float[ndarray, "r c 3"]:
    """A map's change, ``shown`` times where it is ``seen``, 0 to 1, and smoothly on to 0 elsewhere.

    The sooner, the less it is to be trusted.
    """
    around, least = np.zeros_like(shown), LEAST_SEEN / trust
    for angle in CONTINUED_RAD:
        sigma = angle * len(shown) / math.pi
        near = _blurred(seen, sigma)[..., None] + least
        around = (_blurred(shown, sigma) + least * around) / near
    return shown + (1 - seen)[..., None] * around


@dataclass(frozen=True, kw_only=True)
class View:
    """A photograph's background on pixels of :data:`PIXEL_RAD` or more, seen by ``camera``.

    ``radiance`` is in the light's units and colours; ``known`` is 1 on background and falls to 0
    towards the person, ``border`` to 0 at the picture's edges; ``clipped`` is the share of each
    pixel that is over-exposed.
    """

    camera: Camera
    radiance: Float[ndarray, "h w 3"]
    known: Float[ndarray, "h w"]
    border: Float[ndarray, "h w"]
    clipped: Float[ndarray, "h w"]
    grey: bool

    @staticmethod
    def of(
        behind: BackgroundPixels,
        white_balance: Float[ndarray, "3"],
        grey: bool,
        edit: Edit = UNEDITED,
    ) -> "View":
        """One colour and over-exposed light are shown too: they tell little of the light, but are
        what a mirror would reflect."""
        pixel = behind.camera.focal_px * PIXEL_RAD
        whole = behind.camera.height, behind.camera.width
        height, width = (min(side, max(8, round(side / pixel))) for side in whole)
        size = height, width
        camera = behind.camera.resized(width, height)
        share = _shrunk(behind.usable.astype(np.float32), size)
        before = edit.undo(torch.from_numpy(behind.picture)).numpy()
        seen = _shrunk(before * behind.usable[..., None], size)
        seen = seen / np.maximum(share, 1e-3)[..., None]
        clipped = _shrunk(behind.clipped * behind.usable, size) / np.maximum(share, 1e-3)
        ones = np.pad(np.ones(size, np.uint8), 1)
        edge = cv2.distanceTransform(ones, cv2.DIST_L2, 5)[1:-1, 1:-1] / camera.focal_px
        there = np.pad((share > 0.5).astype(np.uint8), 1, mode="edge")
        beside = cv2.distanceTransform(there, cv2.DIST_L2, 5)[1:-1, 1:-1] / camera.focal_px
        return View(
            camera=camera,
            radiance=(seen / white_balance).astype(np.float64),
            known=_smooth(beside / FEATHER_RAD),
            border=_smooth(edge / min(FEATHER_RAD, 0.2 * min(size) / camera.focal_px)),
            clipped=clipped,
            grey=grey,
        )

    def against(self, base: Float[ndarray, "r c 3"]) -> tuple[Float[ndarray, "h w 3"], float]:
        """D of the module's text, of no meaning where the person stands, and its :func:`trust_in`.

        What it is not trusted for is its level: colours stay the photograph's.
        """
        row, column = pixel_from_direction(self.camera.rays(), *base.shape[:2])
        expected = bilinear(torch.from_numpy(base), row, column).numpy()
        expected = expected.reshape(self.radiance.shape)
        ratio = np.log(self.radiance + FLOOR) - np.log(expected + FLOOR)
        if self.grey:
            ratio = ratio.mean(-1, keepdims=True).repeat(3, -1)
        ratio = np.where(self.clipped[..., None] > 0.5, ratio.clip(0), ratio)
        ratio = ratio.clip(-MOST_DETAIL, MOST_DETAIL)
        weight = self.known * self.border
        mean = (ratio * weight[..., None]).sum((0, 1)) / max(weight.sum(), 1e-9)
        trust = trust_in(mean)
        return ratio - (1 - trust) * mean.mean(), trust


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Where each pixel of a map lies in a view (``x``, ``y``, of its pixels), and how surely it
    shows what the photograph does (``feather``, 0 outside)."""

    x: Float[ndarray, "r c"]
    y: Float[ndarray, "r c"]
    feather: Float[ndarray, "r c"]
    clipped: Float[ndarray, "r c"]

    @staticmethod
    def of_view(view: View, directions: Float[Tensor, "r c 3"]) -> "Sampling":
        """Of all pixels of a map, that look in those ``directions``."""
        layout, directions = directions.shape[:2], directions.reshape(-1, 3)
        ahead = directions[:, 2] < -1e-3
        places = view.camera.project(
            torch.where(ahead[:, None], directions, directions.new_tensor([0.0, 0.0, -1.0]))
        )
        x, y = (places[:, k].reshape(layout).numpy() - 0.5 for k in (0, 1))
        camera = view.camera
        seen = ahead.reshape(layout).numpy()
        seen = seen & (abs(x - camera.width / 2 + 0.5) < camera.width / 2)
        seen = seen & (abs(y - camera.height / 2 + 0.5) < camera.height / 2)
        return Sampling(
            x=x,
            y=y,
            feather=np.where(seen, _looked_up(view.border, x, y), 0.0),
            clipped=np.where(seen, _looked_up(view.clipped * view.known, x, y), 0.0),
        )

    def __call__(self, picture: Float[ndarray, "h w *c"]) -> Float[ndarray, "r c *c"]:
        """A view's picture at the map's pixels; its border continued beyond."""
        return _looked_up(picture, self.x, self.y)


def surrounding_texture(
    ratio: Float[ndarray, "h w 3"], view: View, layout: tuple[int, int]
) -> Float[ndarray, "r c 3"]:
    """Logarithm of a texture round the sphere: the view's, mirrored at its edges again and again.

    Beyond the edges it is enlarged by about :data:`ENLARGED`, so that an odd number of views closes
    the circle; above and below the view, where it is mirrored no farther than to the horizon, it
    fades. People have none.
    """
    camera, known = view.camera, view.known * view.border * (view.clipped < 0.5)
    sigma, weight = TEXTURE_RAD * camera.focal_px, (known + 1e-6)[..., None]
    mean = _blurred(ratio * weight, sigma) / _blurred(weight[..., 0], sigma)[..., None]
    known = known * _smooth(2 * _blurred(known, sigma) - 0.5)  # it fades towards people
    detail = known[..., None] * MOST_TEXTURE * np.tanh((ratio - mean) / MOST_TEXTURE)
    left, top, right, bottom = (
        math.atan(pixels / camera.focal_px)
        for pixels in (
            -camera.center_px[0],
            camera.center_px[1],
            camera.width - camera.center_px[0],
            camera.center_px[1] - camera.height,
        )
    )
    width = right - left
    rest = math.tau - width
    views = max(2 * round((rest / (ENLARGED * width) - 1) / 2) + 1, 1)
    smaller = views * width / rest
    azimuth, zenith = angles_from_direction(DirectionGrid.latlong(*layout).directions)
    azimuth, height = azimuth.numpy(), math.pi / 2 - zenith.numpy()
    aside = (azimuth - right).clip(0) - (left - azimuth).clip(0)  # beyond the edges
    unfolded = azimuth - (1 - smaller) * aside - left
    azimuth = left + width - abs(unfolded % (2 * width) - width)
    above, below = (height - top).clip(0), (bottom - height).clip(0)
    folded = np.where(above > 0, (top - smaller * above).clip(min(top, 0.0)), height)
    folded = np.where(below > 0, (bottom + smaller * below).clip(max=max(bottom, 0.0)), folded)
    towards = direction_from_angles(
        torch.from_numpy(azimuth), torch.from_numpy(math.pi / 2 - folded)
    )
    faded = _smooth(1 - (above + below) / FADE_RAD).reshape(layout)
    return faded[..., None] * Sampling.of_view(view, towards.reshape(*layout, 3))(detail)


def gain_back_to(
    base: Float[ndarray, "h w 3"],
    light: Float[ndarray, "h w 3"],
    free: Float[ndarray, "h w"],
    degree: int,
) -> Float[ndarray, "h w 3"]:
    """``1 + free (exp(sum_k c_k Y_k) - 1)``, by which ``light`` gets the harmonics of ``base``.

    Of even degrees and 1, to ``degree``: all that irradiance depends on. The c minimise
    ``sum_w dw light (free exp(c Y) + (1 - free) c Y) - c b``, b the harmonics of ``base``: convex,
    solved by Newton's method on :data:`SOLVED_ROWS` rows.
    """
    grid = DirectionGrid.latlong(SOLVED_ROWS)
    weight = grid.solid_angles.numpy()[:, None]
    wanted = [index for n in (0, 1, 2, 4) if n <= degree for index in range(n**2, (n + 1) ** 2)]
    basis = harmonics.evaluate(grid.directions, degree)[:, wanted].numpy().astype(np.float64)
    moved = light * free[..., None]
    goal, after = (
        weight * averaged(torch.from_numpy(each), SOLVED_ROWS).reshape(-1, 3).numpy()
        for each in (base - light + moved, moved)
    )
    goal, whole = basis.T @ goal, math.sqrt(4 * math.pi) * base.mean()
    factors = np.zeros((basis.shape[1], 3))
    for channel in range(3):
        c = factors[:, channel]
        for _ in range(30):
            now = after[:, channel] * np.exp((basis @ c).clip(-5, 5))
            gap = basis.T @ now - goal[:, channel]
            if np.abs(gap).max() < 1e-6 * whole:
                break
            hessian = basis.T @ (now[:, None] * basis)
            hessian += 1e-9 * np.trace(hessian) * np.eye(len(c))
            step = np.linalg.solve(hessian, gap)
            c -= step * min(1.0, 1.0 / max(np.abs(basis @ step).max(), 1e-12))
    directions = DirectionGrid.latlong(*base.shape[:2]).directions
    field = harmonics.evaluate(directions, degree)[:, wanted].numpy() @ factors
    return 1 + free[..., None] * (np.exp(field.reshape(base.shape).clip(-5, 5)) - 1)


def _shrunk(picture: Float[ndarray, "h w *c"], size: tuple[int, int]) -> Float[ndarray, "p q *c"]:
    return cv2.resize(picture, size[::-1], interpolation=cv2.INTER_AREA)


def _blurred(picture: Float[ndarray, "h w *c"], sigma: float) -> Float[ndarray, "h w *c"]:
    # at most three deviations, so that a kernel is no larger than what it is reflected in
    return cv2.GaussianBlur(picture, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)


def _looked_up(
    picture: Float[ndarray, "h w *c"], x: Float[ndarray, "r c"], y: Float[ndarray, "r c"]
) -> Float[ndarray, "r c *c"]:
    across, along = (np.ascontiguousarray(each, dtype=np.float32) for each in (x, y))
    return cv2.remap(picture, across, along, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _smooth(x: Float[ndarray, "*s"]) -> Float[ndarray, "*s"]:
    """0 to 1, level at both ends."""
    x = x.clip(0, 1)
    return x * x * (3 - 2 * x)
