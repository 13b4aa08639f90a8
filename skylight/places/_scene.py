"""Scenes of rectangles about a viewer: walls with holes, boxes, panels of light, small lamps.

Metres, in the frame of maps (+Y up), the viewer at the origin. Light is in the unit of skies: the
illuminance of the sun above the atmosphere is 1 (:data:`SUN_LUX`), so a lamp of ``phi`` lumens
that sends them everywhere alike has an intensity of phi / (4 pi SUN_LUX).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.skies._scattering import XYZ_FROM_RGB, colour_matching
from skylight.sphere._envmap import LUMINANCE
from skylight.transport._rays import Raycaster

SUN_LUX = 133.3e3  # Darula, Kittler & Gueymard 2005
Real = float | int
Triple = Sequence[Real] | np.ndarray
NO_LIGHT = (0.0, 0.0, 0.0)
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, kw_only=True)
class Material:
    """A Lambertian ``albedo`` under a coat that mirrors ``gloss`` of what falls on it head-on.

    The log albedo varies by ``texture`` (standard deviation) over ``grain_m`` and more. The mirror
    blurs by ``roughness`` rad.
    """

    albedo: Triple
    gloss: Real = 0.0
    roughness: Real = 0.15
    texture: Real = 0.0
    grain_m: Real = 0.5


BLACK = Material(albedo=NO_LIGHT)


@dataclass(frozen=True, kw_only=True)
class Rectangle:
    """``corner + a along + b across``, a and b from 0 to 1; along x across is its front's normal.

    ``radiance`` is sent from the front, evenly. Rectangles of one ``lamp`` (a number, or None) are
    one light. Nothing is there where ``window`` is true: the light from outside enters there.
    """

    corner: np.ndarray
    along: np.ndarray
    across: np.ndarray
    material: Material = BLACK
    radiance: Triple = NO_LIGHT
    lamp: int | None = None
    window: bool = False


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A ball of ``radius_m`` at ``position``: candelas over :data:`SUN_LUX` in each channel.

    ``intensity`` cos^``focus`` about ``axis``; a focus of 0 is everywhere alike.
    """

    position: Triple
    intensity: Triple
    radius_m: Real = 0.03
    axis: Triple = (0.0, -1.0, 0.0)
    focus: Real = 0.0


@dataclass(frozen=True, kw_only=True)
class Outside:
    """The light from far away: a ``map`` without the sun, and the sun (its irradiance may be 0).

    ``shade`` is the share of an open ground that what stands far away hides from the sun, and
    ``sunny`` how much of the sun the viewer has.
    """

    map: Float[Tensor, "h w 3"]
    sun: Float[Tensor, "3"]
    sun_irradiance: Float[Tensor, "3"]
    shade: Real = 0.0
    sunny: Real = 1.0

    @staticmethod
    def uniform(radiance: Triple, height: int = 64) -> "Outside":
        """The same radiance from everywhere."""
        light = torch.tensor(np.asarray(radiance), dtype=torch.float32)
        return Outside(
            map=light.expand(height, 2 * height, 3),
            sun=torch.tensor([0.0, 1.0, 0.0]),
            sun_irradiance=torch.zeros(3),
        )


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What stands about the viewer, and the light from outside.

    In a ``closed`` scene that light comes through windows alone, times ``glass``.
    """

    rectangles: list[Rectangle] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    outside: Outside
    closed: bool = False
    glass: Triple = (1.0, 1.0, 1.0)

    def seen_from(self, eye: Triple, turn_rad: Real = 0.0) -> "Scene":
        """The scene about a viewer elsewhere, turned to the right; the outside stays as it is."""
        c, s = math.cos(turn_rad), math.sin(turn_rad)
        turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        return replace(
            self,
            rectangles=[
                replace(
                    each,
                    corner=turn @ (each.corner - np.asarray(eye)),
                    along=turn @ each.along,
                    across=turn @ each.across,
                )
                for each in self.rectangles
            ],
            lamps=[
                replace(
                    each,
                    position=turn @ (np.asarray(each.position) - np.asarray(eye)),
                    axis=turn @ np.asarray(each.axis),
                )
                for each in self.lamps
            ],
        )


def panel(
    centre: Triple,
    facing: Triple,
    width: Real,
    height: Real,
    material: Material = BLACK,
    radiance: Triple = NO_LIGHT,
    lamp: int | None = None,
) -> Rectangle:
    """A rectangle that faces a direction; its width is level."""
    normal = np.asarray(facing, float) / np.linalg.norm(facing)
    level = np.cross(_UP, normal)
    size = np.linalg.norm(level)
    along = level / size if size > 1e-6 else np.array([1.0, 0.0, 0.0])
    across = np.cross(normal, along)
    corner = np.asarray(centre, float) - along * width / 2 - across * height / 2
    return Rectangle(
        corner=corner,
        along=along * width,
        across=across * height,
        material=material,
        radiance=radiance,
        lamp=lamp,
    )


def box(
    low: Triple,
    high: Triple,
    material: Material,
    *,
    turn_rad: Real = 0.0,
    inward: bool = False,
    radiance: Triple = NO_LIGHT,
    lamp: int | None = None,
) -> list[Rectangle]:
    """The six sides of a box, turned about the vertical through its middle.

    In order: -x, +x, -y, +y, -z, +z.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    size, middle = high - low, (low + high) / 2
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    sides = []
    for axis in range(3):
        for sign in (-1, 1):
            corner = low.copy() if sign < 0 else low + size * (np.arange(3) == axis)
            one, other = ((axis + k) % 3 for k in (1, 2))  # one x other is +axis
            along, across = size * (np.arange(3) == one), size * (np.arange(3) == other)
            if (sign < 0) != inward:
                along, across = across, along
            sides.append(
                Rectangle(
                    corner=middle + turn @ (corner - middle),
                    along=turn @ along,
                    across=turn @ across,
                    material=material,
                    radiance=radiance,
                    lamp=lamp,
                )
            )
    return sides


@dataclass(frozen=True)
class Hole:
    """From (a0, b0) to (a1, b1), in shares of a wall's sides."""

    a0: Real
    a1: Real
    b0: Real
    b1: Real

    def within(self, a: Real, b: Real) -> bool:
        return self.a0 < a < self.a1 and self.b0 < b < self.b1


def pierced(wall: Rectangle, holes: Iterable[Hole], lamp: int | None = None) -> list[Rectangle]:
    """A wall in pieces about its holes, and the holes as windows."""
    holes = list(holes)
    a = sorted({0.0, 1.0, *(h.a0 for h in holes), *(h.a1 for h in holes)})
    b = sorted({0.0, 1.0, *(h.b0 for h in holes), *(h.b1 for h in holes)})
    pieces = []

    def part(a0: Real, a1: Real, b0: Real, b1: Real, **changes: object) -> Rectangle:
        return replace(
            wall,
            corner=wall.corner + a0 * wall.along + b0 * wall.across,
            along=(a1 - a0) * wall.along,
            across=(b1 - b0) * wall.across,
            **changes,
        )

    for a0, a1 in pairwise(a):
        for b0, b1 in pairwise(b):
            if not any(h.within((a0 + a1) / 2, (b0 + b1) / 2) for h in holes):
                pieces.append(part(a0, a1, b0, b1))
    for k, h in enumerate(holes):
        number = None if lamp is None else lamp + k
        pieces.append(part(h.a0, h.a1, h.b0, h.b1, window=True, lamp=number))
    return pieces


@dataclass(frozen=True, kw_only=True)
class Surfaces:
    """The rectangles of a scene as tensors, and rays against them."""

    corner: Float[Tensor, "q 3"]
    along: Float[Tensor, "q 3"]
    across: Float[Tensor, "q 3"]
    normal: Float[Tensor, "q 3"]
    area: Float[Tensor, " q"]
    radiance: Float[Tensor, "q 3"]

    @staticmethod
    def of(rectangles: Sequence[Rectangle]) -> "Surfaces":
        def rows(values: list) -> Float[Tensor, "q 3"]:
            return torch.tensor(np.array(values).reshape(-1, 3), dtype=torch.float32)

        corner = rows([each.corner for each in rectangles])
        along = rows([each.along for each in rectangles])
        across = rows([each.across for each in rectangles])
        normal = torch.linalg.cross(along, across)
        area = normal.norm(dim=1)
        return Surfaces(
            corner=corner,
            along=along,
            across=across,
            normal=normal / area[:, None],
            area=area,
            radiance=rows([each.radiance for each in rectangles]),
        )

    @cached_property
    def rays(self) -> Raycaster | None:
        if not len(self):
            return None
        one, other = self.corner + self.along, self.corner + self.across
        corners = torch.stack([self.corner, one, one + self.across, other], 1)
        first = 4 * torch.arange(len(self))[:, None, None]
        faces = first + torch.tensor([[0, 1, 2], [0, 2, 3]])
        return Raycaster(corners.reshape(-1, 3), faces.reshape(-1, 3))

    def __len__(self) -> int:
        return len(self.corner)

    def hit(
        self, starts: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]
    ) -> tuple[Int[Tensor, " r"], Float[Tensor, "r 3"]]:
        """(the first rectangle along each ray or -1, where)."""
        if self.rays is None:
            return torch.full((len(starts),), -1), starts
        face = self.rays.faces_hit(starts, directions)
        which = torch.where(face < 0, -1, face // 2)
        normal = self.normal[which]
        slope = (directions * normal).sum(1)
        way = ((self.corner[which] - starts) * normal).sum(1) / torch.where(
            slope.abs() < 1e-9, 1e-9, slope
        )
        return which, starts + way[:, None] * directions

    def reaches(
        self, starts: Float[Tensor, "r 3"], targets: Float[Tensor, "r 3"]
    ) -> Float[Tensor, " r"]:
        """1 where the way to a point is free, else 0."""
        if self.rays is None:
            return torch.ones(len(starts))
        return 1.0 - self.rays.between(starts, targets).float()

    def free(
        self, starts: Float[Tensor, "r 3"], directions: Float[Tensor, "#r 3"]
    ) -> Float[Tensor, " r"]:
        """1 where a ray meets nothing at all, else 0."""
        if self.rays is None:
            return torch.ones(len(starts))
        return 1.0 - self.rays.occluded(starts, directions).float()

    def within(self, which: Int[Tensor, " r"], places: Float[Tensor, "r 3"]) -> tuple[Tensor, ...]:
        """How far along and across a rectangle a place on it lies, each 0 to 1."""
        away = places - self.corner[which]
        return tuple(
            ((away * side[which]).sum(1) / side[which].square().sum(1)).clamp(0, 1 - 1e-6)
            for side in (self.along, self.across)
        )

    def at(
        self, which: Int[Tensor, " r"], a: Float[Tensor, " r"], b: Float[Tensor, " r"]
    ) -> Float[Tensor, "r 3"]:
        """The place so far along and across."""
        along, across = self.along[which], self.across[which]
        return self.corner[which] + a[:, None] * along + b[:, None] * across


@cache
def black_body(kelvin: Real, green: Real = 0.0) -> tuple[float, float, float]:
    """Linear Rec.709 of luminance 1 of a black body's light; ``green`` is added to log G.

    Planck's law through the observer of 1931. What Rec.709 cannot say is 0.02 of the luminance.
    """
    nm = np.arange(380.0, 781.0, 5.0)
    power = nm**-5 / np.expm1(1.4388e7 / (nm * kelvin))
    rgb = np.linalg.inv(XYZ_FROM_RGB) @ (power @ colour_matching(nm))
    rgb = (rgb / (rgb @ LUMINANCE)).clip(0.02) * [1.0, math.exp(green), 1.0]
    red, grn, blue = (rgb / (rgb @ LUMINANCE)).tolist()
    return red, grn, blue
