"""The photograph's own pixels in the map of its light, and its texture round the sphere.

Inside of its view a photograph shows the light itself, in the units of the estimate: its linear
values without its edit, over the white balance. With P that picture and L the estimate without its
sun and lamps, ::

    D = ln P - ln L = low + high,

``low`` a mean over :data:`LOW_RAD` of what is known
(:class:`~skylight.faces._background.BackgroundPixels`). Where they agree within a doubt, the view
gets the photograph's pixels; where ``low`` is large beyond doubt (a wall at one metre, a backdrop),
the estimate's level with the photograph's detail (:func:`believed`). Where a pixel is clipped D is
a lower bound, and never darkens.

``mirrored`` multiplies what lies outside of the view by ``exp(high)`` of patches of the view
(:func:`surrounding_texture`): above the horizon of what is above it, below of what is below.

The light does not change: outside of the view, the map is multiplied by ``exp(sum_k c_k Y_k)`` with
the c by which its harmonics are the estimate's in all degrees that irradiance depends on, up to 6
(Ramamoorthi and Hanrahan 2001). Of all maps with those harmonics, that is nearest to the detailed
one in relative entropy.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from skylight._names import DetailName
from skylight.estimation._lights import lights_apart
from skylight.faces._background import BackgroundPixels
from skylight.imaging._edits import UNEDITED, Edit
from skylight.inverse._result import Estimate
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap, averaged, bilinear
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from skylight.transport._cameras import Camera

PIXEL_RAD = math.radians(0.35)  # of the view, at least: half a pixel of the map
LOW_RAD = math.radians(8.0)  # standard deviation of the mean that is called low
BORDER_RAD, PERSON_RAD = math.radians(6.0), math.radians(3.0)  # feathers
DOUBT = 0.7  # nats between a view and an estimate, where each is believed by half
MOST_DETAIL = 3.0  # nats: a black pixel tells no more
FLOOR = 3e-4  # of the picture's white: one code of eight bits
SOLVED_ROWS = 64
# Patches of texture: so many lie over each other; each has this share of a view's shorter side, and
# is enlarged to this radius, as the sphere is larger than a view
PATCHES, PATCH_SHARE, PATCH_RAD = 12.0, 0.4, math.radians(24.0)
FAINTEST = 0.4  # texture at zenith and nadir
MOST_TEXTURE = 0.7  # nats
MOST_CHANGE = math.log(1.5)  # of what lies outside of the view, to keep the light as it was


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
    low, high = view.against(base)
    inside, beyond = Sampling.of_view(view, base.shape[:2]), np.zeros_like(base)
    if detail == "mirrored":  # where the person stood too
        seen = inside.feather[..., None] * inside(view.known)[..., None]
        beyond = (1 - seen) * surrounding_texture(high, view, base.shape[:2])
    white = inside.clipped > 0.5
    free = np.where(white, 0.0, 1 - inside.feather)
    for share in (1.0, 0.5, 0.25, 0.0):
        change = inside(share * believed(low) + high * view.known[..., None])
        change *= inside.feather[..., None]
        change[white] = change[white].clip(0)
        light, most = with_the_light_of(base, base * np.exp(change + beyond), free)
        if most < MOST_CHANGE:
            break
    return EnvironmentMap(radiance=torch.from_numpy(light).to(lights) + lights)


def believed(low: Float[ndarray, "h w 3"]) -> Float[ndarray, "h w 3"]:
    """``low / (1 + (|low| / DOUBT)^4)``, with the largest of the channels: a few tenths are the
    photograph's to tell, a factor of ten is not."""
    size = np.abs(low).max(-1, keepdims=True) / DOUBT
    return low / (1 + size**4)


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
            known=_smooth(beside / PERSON_RAD),
            border=_smooth(edge / min(BORDER_RAD, 0.2 * min(size) / camera.focal_px)),
            clipped=clipped,
            grey=grey,
        )

    def against(
        self, base: Float[ndarray, "r c 3"]
    ) -> tuple[Float[ndarray, "h w 3"], Float[ndarray, "h w 3"]]:
        """(low, high): D of the module's text; where the person stands low is filled in, high 0."""
        row, column = pixel_from_direction(self.camera.rays(), *base.shape[:2])
        expected = bilinear(torch.from_numpy(base), row, column).numpy()
        expected = expected.reshape(self.radiance.shape)
        ratio = np.log(self.radiance + FLOOR) - np.log(expected + FLOOR)
        if self.grey:
            ratio = ratio.mean(-1, keepdims=True).repeat(3, -1)
        ratio = np.where(self.clipped[..., None] > 0.5, ratio.clip(0), ratio)
        weight = self.known + 1e-6
        sigma = LOW_RAD * self.camera.focal_px
        low = _blurred(ratio * weight[..., None], sigma) / _blurred(weight, sigma)[..., None]
        high = (ratio - low).clip(-MOST_DETAIL, MOST_DETAIL)
        return low, np.where(self.known[..., None] > 0, high, 0.0)


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Where each pixel of a map lies in a view (``x``, ``y``, of its pixels), and how surely it
    shows what the photograph does (``feather``, 0 outside)."""

    x: Float[ndarray, "r c"]
    y: Float[ndarray, "r c"]
    feather: Float[ndarray, "r c"]
    clipped: Float[ndarray, "r c"]

    @staticmethod
    def of_view(view: View, layout: tuple[int, int]) -> "Sampling":
        """Of all pixels of a map of that layout."""
        directions = DirectionGrid.latlong(*layout).directions
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
    high: Float[ndarray, "h w 3"], view: View, layout: tuple[int, int]
) -> Float[ndarray, "r c 3"]:
    """Logarithm of a texture round the sphere: patches of the view, as they are or mirrored.

    Patches overlap and fade into each other, weighted so that contrast is kept. One shows the view
    at its own height, beyond the view's top and bottom what is next to these: above the horizon is
    only what was above it. People are left out. Same view, same texture.
    """
    camera = view.camera
    detail = MOST_TEXTURE * np.tanh(high / MOST_TEXTURE)
    known = view.known * view.border * (view.clipped < 0.5)
    sky = np.arange(camera.height)[:, None] < camera.center_px[1]
    for side in (sky, ~sky):  # a mean of 1 on either side of the horizon
        weight = (known + 1e-3) * side
        mean = _blurred(np.exp(detail) * weight[..., None], LOW_RAD * camera.focal_px)
        total = _blurred(weight, LOW_RAD * camera.focal_px)[..., None]
        even = np.log(mean.clip(1e-9) / total.clip(1e-9))
        detail = np.where(side[..., None], detail - even, detail)
    own = PATCH_SHARE * min(known.shape) / camera.focal_px
    focal = camera.focal_px * math.tan(min(own, PATCH_RAD)) / math.tan(PATCH_RAD)
    side = 2 * round(focal * PATCH_RAD / 2) + 1
    around = cv2.blur(known, (side, side), borderType=cv2.BORDER_CONSTANT)
    directions = DirectionGrid.latlong(*layout).directions.numpy()
    total, squares = np.zeros((len(directions), 3)), np.zeros(len(directions))
    rng, step = np.random.default_rng(0), math.pi / layout[0]
    for centre in _evenly(round(PATCHES / math.sin(PATCH_RAD / 2) ** 2)):
        x, y = _source(centre, around, camera, focal, rng)
        zenith = math.acos(centre[1])  # rows that reach it
        first = max(0, int((zenith - PATCH_RAD) / step)) * layout[1]
        last = min(layout[0], int((zenith + PATCH_RAD) / step) + 2) * layout[1]
        near = first + np.flatnonzero(directions[first:last] @ centre > math.cos(PATCH_RAD))
        right = np.cross(centre, (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        towards = directions[near] / (directions[near] @ centre)[:, None]
        along, up = towards @ right, towards @ np.cross(right, centre)
        px = (x + focal * along * rng.choice((-1.0, 1.0)))[:, None]
        py = (y - focal * up)[:, None]
        weight = _smooth(1.0 - np.hypot(along, up) / math.tan(PATCH_RAD)) ** 2
        weight = weight * _looked_up(known, px, py)[:, 0]
        weight = weight * (np.abs(px[:, 0] - camera.width / 2) < camera.width / 2)
        weight = weight * (np.abs(py[:, 0] - camera.height / 2) < camera.height / 2)
        above = np.sign(directions[near, 1])  # nothing of the ground into the sky
        weight = weight * (above * (py[:, 0] - camera.center_px[1]) < 1)
        total[near] += weight[:, None] * _looked_up(detail, px, py)[:, 0]
        squares[near] += weight**2
    texture = total / np.maximum(np.sqrt(squares), 0.1)[:, None]
    level = 1 - directions[:, 1:2] ** 2
    return (texture * (FAINTEST + (1 - FAINTEST) * level)).reshape(*layout, 3)


def _evenly(count: int) -> Float[ndarray, "n 3"]:
    """So many directions, evenly spread: a spiral by the golden angle."""
    y = 1 - (2 * np.arange(count) + 1) / count
    azimuth = np.arange(count) * math.pi * (3 - math.sqrt(5))
    level = np.sqrt(1 - y**2)
    return np.stack([level * np.sin(azimuth), y, level * np.cos(azimuth)], 1)


def _source(
    centre: Float[ndarray, "3"],
    around: Float[ndarray, "h w"],
    camera: Camera,
    focal: float,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Where in the view a patch is taken from: at its height if the view has that, and of some
    places the one with most background."""
    horizon, half = camera.center_px[1], focal * PATCH_RAD / 2
    height = math.tan(math.asin(min(max(centre[1], -0.99), 0.99)))
    x = rng.uniform(0, camera.width, 16)
    y = np.full(16, horizon - focal * height)
    if height > 0 and y[0] < half:
        y = rng.uniform(min(half, horizon), max(half, horizon / 2), 16)
    elif height < 0 and y[0] > camera.height - half:
        y = rng.uniform(min(horizon, camera.height - half), camera.height - half, 16)
    rows = y.clip(0, camera.height - 1).astype(int)
    chances = around[rows, x.astype(int)] ** 2 + 1e-9
    chosen = int(rng.choice(16, p=chances / chances.sum()))
    return float(x[chosen]), float(y[chosen])


def with_the_light_of(
    base: Float[ndarray, "h w 3"],
    detailed: Float[ndarray, "h w 3"],
    free: Float[ndarray, "h w"],
) -> tuple[Float[ndarray, "h w 3"], float]:
    """``detailed exp(free sum_k c_k Y_k)`` with the low harmonics of ``base``, in each channel.

    The c minimise ``sum_w dw detailed exp(free c Y) / free - c b``, b the harmonics of ``base``:
    convex, solved by Newton's method on :data:`SOLVED_ROWS` rows, to whose means the gradient is
    exact. The second is the largest ``|c Y|`` where the map is free.
    """
    grid = DirectionGrid.latlong(SOLVED_ROWS)
    weight = grid.solid_angles.numpy()[:, None]
    wanted = [index for degree in (0, 1, 2, 4, 6) for index in range(degree**2, (degree + 1) ** 2)]
    basis = harmonics.evaluate(grid.directions, 6)[:, wanted].numpy().astype(np.float64)

    def coarse(picture: Float[ndarray, "h w c"]) -> Float[ndarray, "n c"]:
        whole = torch.from_numpy(np.ascontiguousarray(picture))
        return averaged(whole, SOLVED_ROWS).reshape(-1, picture.shape[2]).numpy()

    held, goal = coarse(detailed * (1 - free[..., None])), basis.T @ (weight * coarse(base))
    moved = coarse(detailed * free[..., None])
    factors, most = np.zeros((basis.shape[1], 3)), 0.0
    for channel in range(3):
        c = factors[:, channel]
        for _ in range(30):
            now = weight[:, 0] * moved[:, channel] * np.exp((basis @ c).clip(-5, 5))
            gap = basis.T @ (now + weight[:, 0] * held[:, channel]) - goal[:, channel]
            if np.abs(gap).max() < 1e-6 * goal[0, channel]:
                break
            hessian = basis.T @ (now[:, None] * basis)
            hessian += 1e-9 * np.trace(hessian) * np.eye(len(c))
            step = np.linalg.solve(hessian, gap)
            c -= step * min(1.0, 1.0 / max(np.abs(basis @ step).max(), 1e-12))
        most = max(most, float(np.abs(basis @ c)[moved[:, channel] > 0].max(initial=0.0)))
    rows, columns = base.shape[:2]
    directions = DirectionGrid.latlong(rows, columns).directions
    field = harmonics.evaluate(directions, 6)[:, wanted].numpy() @ factors
    gain = np.exp(field.clip(-5, 5)).reshape(base.shape)
    return detailed * (1 + free[..., None] * (gain - 1)), most


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
