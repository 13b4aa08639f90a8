"""What stands behind rendered people, as photographs have it.

All geometry is about the head: its origin is there, its axes are the camera's, its unit the metre.
A place is a box on whose inside its light is painted as the head sees it (Lagarde & Zanuttini
2012, "Local image-based lighting with parallax-corrected cubemaps"): the camera, which stands
elsewhere, sees the point X of it with the radiance of the direction X / |X|. Outdoors the box is
the ground alone. Walls, studios' backdrops and screens are rectangles before it, which become part
of the light. The lens is thin and focused on the head: every pixel is the mean over the lens of the
light that comes through one point of the head's plane (Cook et al. 1984, "Distributed ray
tracing"), so what a head covers is seen round it and its own edge stays sharp. People's shadows on
walls are left out.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from torch import Tensor

from skylight.people._light import DistantLight
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from skylight.transport._cameras import Camera

BackgroundKind = Literal[
    "infinite", "open", "room", "wall", "backdrop", "screen", "cut-out", "round", "border"
]
# Half of the people stand freely in their place, as most do who are photographed; a fifth before
# a wall or a backdrop. Of what tells nothing of the light, which is rarer among photographs, there
# is enough to be measured in a hundred faces.
SHARES: dict[BackgroundKind, float] = {
    "infinite": 0.05,
    "open": 0.5,  # or a room, where the light is one
    "wall": 0.14,
    "backdrop": 0.08,
    "screen": 0.06,
    "cut-out": 0.06,
    "round": 0.05,
    "border": 0.06,
}
INDOORS = ("indoor", "home", "workplace", "car", "studio")  # categories of maps
_PHONES = 0.6  # of photographs; the rest are of larger cameras
_LENS_POINTS = 128  # at most
_APART_PX = 2.0  # points of the lens as the background's blur shows them
_FINER = 4  # directions across a pixel of the light that a panel covers in part
_GOLDEN = math.pi * (3 - math.sqrt(5))
_BRIGHTEST = 0.95  # albedo of paint


@dataclass(frozen=True, kw_only=True)
class Lens:
    """``focal_mm`` is the true focal length, whatever part of the picture is kept."""

    focal_mm: float
    f_number: float

    @property
    def aperture_m(self) -> float:
        return self.focal_mm / self.f_number / 1000

    def blur_px(self, camera: Camera, focus_m: float, depth_m: float) -> float:
        """The circle of confusion's diameter, ``f A |1/s - 1/z|``, of a thin lens.

        f is the focal length in pixels, A the aperture, s the distance in focus, z the other's.
        """
        return camera.focal_px * self.aperture_m * abs(1 / focus_m - 1 / depth_m)


@dataclass(frozen=True, kw_only=True)
class Panel:
    """An upright rectangle ``depth_m`` behind the head that faces the camera, of this radiance.

    ``left``, ``right``, ``bottom`` and ``top`` are its borders' x and y.
    """

    depth_m: float
    left: float
    right: float
    bottom: float
    top: float
    radiance: Float[ndarray, "h w 3"]

    def along(
        self, origin: Float[Tensor, "3"], rays: Float[Tensor, "n 3"]
    ) -> tuple[Bool[Tensor, " n"], Float[Tensor, "n 3"]]:
        """Which rays meet it, and what they see there."""
        ahead = rays[:, 2] < 0
        way = torch.where(ahead, (-self.depth_m - origin[2]) / rays[:, 2], 0.0)
        x, y = (origin[k] + way * rays[:, k] for k in (0, 1))
        hit = ahead & (x > self.left) & (x < self.right) & (y > self.bottom) & (y < self.top)
        height, width = self.radiance.shape[:2]
        column = (x - self.left) / (self.right - self.left) * width - 0.5
        row = (self.top - y) / (self.top - self.bottom) * height - 0.5
        return hit, _looked_up(self.radiance, row, column, cv2.BORDER_REPLICATE)

    def within(self, place: "Background") -> "Panel":
        """The part of it between the walls, the floor and the ceiling of a place."""
        return replace(
            self,
            left=max(self.left, place.low[0]),
            right=min(self.right, place.high[0]),
            bottom=max(self.bottom, place.low[1]),
            top=min(self.top, place.high[1]),
        )

    def before(self, light: DistantLight) -> DistantLight:
        """What the head sees of a light when it stands there."""
        height, _ = light.diffuse.layout
        rays = DirectionGrid.latlong(_FINER * height).directions.float()
        fine = light.diffuse.radiance.float().repeat_interleave(_FINER, 0)
        fine = fine.repeat_interleave(_FINER, 1)
        hit, seen = self.along(torch.zeros(3), rays)
        covered = torch.where(hit[:, None], seen, fine.reshape(-1, 3)).reshape(fine.shape)
        sun = light.sun
        if sun is not None and bool(self.along(torch.zeros(3), sun.direction[None].float())[0]):
            sun = None
        return DistantLight(EnvironmentMap(radiance=covered).resize(height), sun)


@dataclass(frozen=True, kw_only=True)
class Edit:
    """Parts of the picture that are ``value`` of white: not the head, or outside a disc or frame.

    ``radius`` is a disc's, over half the picture's side; ``bars`` are the frame's left and right,
    and its upper and lower, part of the sides.
    """

    value: float
    cut_out: bool = False
    radius: float | None = None
    bars: tuple[float, float] = (0.0, 0.0)

    def where(self, cover: Float[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
        if self.cut_out:
            return cover == 0
        height, width = cover.shape
        x = np.abs((np.arange(width) + 0.5) / width * 2 - 1)
        y = np.abs((np.arange(height) + 0.5) / height * 2 - 1)[:, None]
        if self.radius is not None:
            return x**2 + y**2 > self.radius**2
        return (x > 1 - 2 * self.bars[0]) | (y > 1 - 2 * self.bars[1])


@dataclass(frozen=True, kw_only=True)
class Background:
    """``low`` and ``high`` are the box's corners; what is behind the camera is not seen.

    Without a ``lens`` all of it is sharp.
    """

    kind: BackgroundKind
    low: tuple[float, float, float] = (-math.inf, -math.inf, -math.inf)
    high: tuple[float, float, float] = (math.inf, math.inf, math.inf)
    lens: Lens | None = None
    panel: Panel | None = None
    edit: Edit | None = None

    @property
    def depth_m(self) -> float:
        """From the head to what is behind it."""
        return -self.low[2] if self.panel is None else self.panel.depth_m

    def seen(
        self, light: DistantLight, camera: Camera, head: Float[ndarray, "3"]
    ) -> Float[ndarray, "h w 3"]:
        """The picture without the person, whose ``head`` is there in the camera's frame."""
        focus = -float(head[2])
        rays = camera.rays().float()
        in_focus = rays / -rays[:, 2:] * focus
        points = self._lens_points(camera, focus)
        picture = np.zeros((camera.height, camera.width, 3))
        for point in points:
            origin = point - torch.from_numpy(head).float()
            ways = torch.nn.functional.normalize(in_focus - point, dim=1)
            seen = light_along(light, self._on_box(origin, ways), 1 / camera.focal_px)
            if self.panel is not None:
                hit, nearer = self.panel.along(origin, ways)
                seen = torch.where(hit[:, None], nearer, seen)
            picture += seen.numpy().reshape(picture.shape)
        return picture / len(points)

    def _lens_points(self, camera: Camera, focus_m: float) -> Float[Tensor, "k 3"]:
        """Even over the aperture (Vogel 1979), so many that the blur of a point is one spot."""
        if self.lens is None:
            return torch.zeros(1, 3)
        blur = self.lens.blur_px(camera, focus_m, math.inf)
        many = min(_LENS_POINTS, math.ceil(math.pi / 4 * (blur / _APART_PX) ** 2))
        k = torch.arange(many) + 0.5
        radius = self.lens.aperture_m / 2 * (k / many).sqrt()
        points = torch.stack([radius * (_GOLDEN * k).cos(), radius * (_GOLDEN * k).sin(), 0 * k], 1)
        return points - points.mean(0)

    def _on_box(
        self, origin: Float[Tensor, "3"], ways: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 3"]:
        """Unit vectors from the head to where rays leave the box; rays that never do, as given."""
        low, high = torch.tensor(self.low), torch.tensor(self.high)
        out = torch.where(ways > 0, high - origin, low - origin) / ways
        way = out.where(ways != 0, math.inf).amin(1, keepdim=True)
        place = origin + way.where(way.isfinite(), 0.0) * ways
        return torch.where(way.isfinite(), torch.nn.functional.normalize(place, dim=1), ways)


@dataclass(frozen=True, kw_only=True)
class BackgroundFacts:
    """What is told of a face's background: metres behind the head, blur there in pixels.

    ``depth_m`` is None where nothing is there at a finite depth.
    """

    kind: BackgroundKind
    depth_m: float | None
    blur_px: float

    @staticmethod
    def of(background: Background, camera: Camera, head: Float[ndarray, "3"]) -> "BackgroundFacts":
        depth, focus = background.depth_m, -float(head[2])
        lens = background.lens
        blur = 0.0 if lens is None else lens.blur_px(camera, focus, focus + depth)
        return BackgroundFacts(
            kind=background.kind, depth_m=depth if math.isfinite(depth) else None, blur_px=blur
        )


def background(
    light: DistantLight,
    camera: Camera,
    world_from_camera: Float[ndarray, "3 3"] | None = None,
) -> Float[ndarray, "h w 3"]:
    """What a camera sees of the light, a level one that looks ahead or a turned one."""
    rays = camera.rays()
    if world_from_camera is not None:
        rays = rays @ torch.from_numpy(world_from_camera.T.copy())
    seen = light_along(light, rays, 1 / camera.focal_px)
    return seen.numpy().reshape(camera.height, camera.width, 3)


def light_along(
    light: DistantLight, rays: Float[Tensor, "n 3"], pixel_rad: float
) -> Float[Tensor, "n 3"]:
    """Radiance from unit directions: the map is interpolated, the sun is a disc."""
    radiance = light.diffuse.radiance.float().numpy()
    row, column = pixel_from_direction(rays, *light.diffuse.layout)
    seen = _looked_up(radiance, row, column, cv2.BORDER_WRAP)
    if light.sun is None:
        return seen
    return seen + light.sun.in_pixels(rays, pixel_rad).float()


def _looked_up(
    image: Float[ndarray, "h w 3"], row: Float[Tensor, " n"], column: Float[Tensor, " n"], beyond
) -> Float[Tensor, "n 3"]:
    # as one column: cv2 wants fewer than 32,767 rows or columns, so several of them
    many = len(row)
    columns = math.ceil(many / _MOST_ROWS)
    size = -(-many // columns)
    places = torch.zeros(2, columns * size)
    places[0, :many], places[1, :many] = column, row
    x, y = (each.reshape(columns, size).numpy() for each in places)
    source = np.ascontiguousarray(image, np.float32)
    found = cv2.remap(source, x, y, cv2.INTER_LINEAR, borderMode=beyond)
    return torch.from_numpy(found).reshape(-1, 3)[:many]


_MOST_ROWS = 30_000
_UPRIGHT = torch.tensor([0.0, 0.0, 1.0])  # towards the camera


def draw_background(
    rng: np.random.Generator, light: DistantLight, category: str | None
) -> tuple[Background, DistantLight]:
    """A background of a place, and its light with what stands in it; shares of :data:`SHARES`."""
    kinds = list(SHARES)
    kind = kinds[rng.choice(len(kinds), p=list(SHARES.values()))]
    if kind == "infinite":
        return Background(kind=kind), light
    place = _room(rng, category) if category in INDOORS else _open(rng)
    place = replace(place, lens=_lens(rng))
    if kind in ("wall", "backdrop", "screen"):
        panel = _panel(rng, kind, light.environment).within(place)
        low = place.low[0], place.low[1], min(place.low[2], -panel.depth_m - 0.01)
        return replace(place, kind=kind, low=low, panel=panel), panel.before(light)
    if kind == "cut-out":
        value = float(rng.choice([1.0, 1.0, 0.0, rng.uniform(0.2, 0.9)]))
        return replace(place, kind=kind, edit=Edit(value=value, cut_out=True)), light
    if kind == "round":
        edit = Edit(value=float(rng.choice([1.0, 1.0, 0.0])), radius=float(rng.uniform(0.9, 1)))
        return replace(place, kind=kind, edit=edit), light
    if kind == "border":
        across, down = float(rng.uniform(0.04, 0.14)), float(rng.uniform(0.02, 0.07))
        sides = rng.integers(3)
        bars = (across * (sides != 1), down * (sides != 0))
        return replace(
            place, kind=kind, edit=Edit(value=float(rng.choice([0.0, 0.0, 1.0])), bars=bars)
        ), light
    return place, light


def _lens(rng: np.random.Generator) -> Lens:
    """Telephones' main cameras to tele lenses, or 35 to 85 mm on larger sensors."""
    if rng.random() < _PHONES:
        return Lens(focal_mm=float(rng.uniform(4, 9)), f_number=float(rng.uniform(1.6, 2.8)))
    return Lens(focal_mm=float(rng.uniform(35, 85)), f_number=float(math.exp(rng.uniform(0.5, 2))))


def _open(rng: np.random.Generator) -> Background:
    """Level ground below eyes that are 1.1 (seated) to 1.75 m high; all else is far away."""
    return Background(kind="open", low=(-math.inf, -float(rng.uniform(1.1, 1.75)), -math.inf))


def _room(rng: np.random.Generator, category: str | None) -> Background:
    """A room of usual size, or the inside of a car."""
    sizes = (1.0, 4.0), (1.1, 1.7), (0.8, 5.0), (0.8, 1.6)
    if category == "car":
        sizes = (0.45, 0.9), (0.7, 0.9), (0.5, 1.6), (0.25, 0.45)
    left, right = (float(rng.uniform(*sizes[0])) for _ in range(2))
    floor, back, ceiling = (float(rng.uniform(*size)) for size in sizes[1:])
    return Background(kind="room", low=(-left, -floor, -back), high=(right, ceiling, math.inf))


def _panel(rng: np.random.Generator, kind: BackgroundKind, environment: EnvironmentMap) -> Panel:
    """A wall or backdrop lit by what is before it, or a screen as bright as that, give or take."""
    depth = float(rng.uniform(0.5, 3.0))
    irradiance = environment.irradiance(_UPRIGHT).double().numpy()
    left, right, bottom, top = -rng.uniform(1, 4), rng.uniform(1, 4), -1.6, rng.uniform(0.8, 2.5)
    if kind == "wall":
        albedo = math.exp(rng.uniform(math.log(0.15), math.log(0.85))) * _tint(rng, 0.15)
        texture = _texture(rng, (64, 96), (4, 16, 48), rng.uniform(0.02, 0.12))
    elif kind == "backdrop":
        left, right, top = -1.35, 1.35, 1.2  # paper is 2.72 m wide
        albedo = rng.choice([0.04, 0.2, 0.85, 0.3]) * _tint(rng, float(rng.choice([0.02, 0.5])))
        texture = np.ones((1, 1, 3))
    else:
        width = rng.uniform(0.5, 2.0)
        middle = rng.uniform(-0.3, 0.3)
        left, right = middle - width / 2, middle + width / 2
        bottom, top = -0.28 * width, 0.28 * width
        bright = math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
        level = bright * float(luminance(environment.irradiance(_UPRIGHT))) / math.pi
        colours = [_texture(rng, (36, 64), (3, 12), 0.8)[..., :1] for _ in range(3)]
        radiance = level * np.concatenate(colours, 2)
        return _of(depth, left, right, bottom, top, radiance)
    return _of(depth, left, right, bottom, top, reflected(albedo, texture, irradiance))


def _of(depth, left, right, bottom, top, radiance: Float[ndarray, "h w 3"]) -> Panel:
    return Panel(
        depth_m=depth,
        left=float(left),
        right=float(right),
        bottom=float(bottom),
        top=float(top),
        radiance=radiance.astype(np.float32),
    )


def reflected(
    albedo: Float[ndarray, "3"],
    texture: Float[ndarray, "h w c"],
    irradiance: Float[ndarray, "3"],
) -> Float[ndarray, "h w 3"]:
    """a t E / pi, with a texture t of mean 1 and the albedo a reduced to what paint has."""
    albedo = np.minimum(albedo, _BRIGHTEST / texture.max())
    return albedo * texture * irradiance / math.pi


def _tint(rng: np.random.Generator, spread: float) -> Float[ndarray, "3"]:
    """Log-normal factors on the channels whose geometric mean is 1."""
    logs = rng.normal(0, spread, 3)
    return np.exp(logs - logs.mean())


def _texture(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[int, ...], spread: float
) -> Float[ndarray, "h w 3"]:
    """Log-normal, of octaves of so many cells, of mean 1."""
    height, width = shape
    logs = np.zeros(shape, np.float32)
    for many in cells:
        coarse = rng.normal(0, spread, (many, many)).astype(np.float32)
        logs += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    grey = np.exp(logs)
    return np.repeat((grey / grey.mean())[..., None], 3, 2)
