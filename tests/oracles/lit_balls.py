"""What balls and heads do to each other's light, ray by ray: slow, in float64.

Light comes from a lat-long map, radiance (h, 2h, 3), row 0 the zenith, -Z in the middle. Surfaces
reflect diffusely (or mirror) what comes straight from the map, after one bounce at most.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """An ellipsoid along the axes; mirrors have a reflectance in place of an albedo."""

    centre: tuple[float, float, float]
    axes: tuple[float, float, float]
    albedo: tuple[float, float, float]
    mirrors: bool = False

    def hit(self, start: Array, towards: Array) -> Array:
        """How far along each direction (n, 3) it is met from a point outside; inf where not."""
        start = (start - np.array(self.centre)) / self.axes
        towards = towards / np.array(self.axes)
        a, b, c = (towards**2).sum(-1), (towards * start).sum(-1), (start**2).sum() - 1
        root = b * b - a * c
        along = (-b - np.sqrt(np.maximum(root, 0))) / a
        return np.where((root > 0) & (along > 1e-9), along, np.inf)

    def normal(self, points: Array) -> Array:
        out = (points - np.array(self.centre)) / np.array(self.axes) ** 2
        return out / np.linalg.norm(out, axis=-1, keepdims=True)


class Light:
    """A map, by its pixels' directions and solid angles."""

    def __init__(self, radiance: Array) -> None:
        height, width = radiance.shape[:2]
        edges = np.pi * np.arange(height + 1) / height
        zenith = (edges[:-1] + edges[1:]) / 2
        azimuth = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
        z, a = np.meshgrid(zenith, azimuth, indexing="ij")
        directions = np.stack([np.sin(z) * np.sin(a), np.cos(z), -np.sin(z) * np.cos(a)], -1)
        omega = 2 * np.pi / width * (np.cos(edges[:-1]) - np.cos(edges[1:]))
        self.radiance = radiance.reshape(-1, 3)
        self.directions = directions.reshape(-1, 3)
        self.omega = np.repeat(omega, width)
        self.shape = height, width

    def towards(self, directions: Array) -> Array:
        """Radiance of the pixels in these directions."""
        height, width = self.shape
        row = np.arccos(np.clip(directions[..., 1], -1, 1)) / np.pi * height
        column = (np.arctan2(directions[..., 0], -directions[..., 2]) / (2 * np.pi) + 0.5) * width
        row, column = row.astype(int).clip(0, height - 1), column.astype(int) % width
        return self.radiance[row * width + column]

    def irradiance(
        self, point: Array, normal: Array, bodies: list[Body], ground_of: Body | None = None
    ) -> Array:
        """At a point among bodies. With ``ground_of`` light from below comes off the plane at the
        foot of that ball, which lies in the ball's own shade of an even sky, r^2 h / d^3."""
        cosine = self.directions @ normal
        front = cosine > 0
        towards, weight = self.directions[front], (cosine * self.omega)[front]
        seen = self.radiance[front].copy()
        if ground_of is not None:
            seen *= _open(point, towards, ground_of)[:, None]
        nearest = np.full(len(towards), np.inf)
        for body in bodies:
            far = body.hit(point, towards)
            first = far < nearest
            nearest = np.where(first, far, nearest)
            if not first.any():
                continue
            places = point + far[first, None] * towards[first]
            normals = body.normal(places)
            if body.mirrors:
                out = towards[first]
                out = out - 2 * (out * normals).sum(-1, keepdims=True) * normals
                seen[first] = np.array(body.albedo) * self.towards(out)
            else:
                received = np.array(
                    [
                        self.irradiance(place, n, [], ground_of)
                        for place, n in zip(places, normals, strict=True)
                    ]
                )
                seen[first] = np.array(body.albedo) / np.pi * received
        return weight @ seen


def _open(point: Array, towards: Array, ball: Body) -> Array:
    """The share of an even sky's light at the places of the plane that are seen from a point."""
    centre, radius = np.array(ball.centre), ball.axes[0]
    foot = centre[1] - radius
    down = towards[:, 1] < 0
    open_sky = np.ones(len(towards))
    far = (foot - point[1]) / towards[down, 1]
    to = centre - (point + far[:, None] * towards[down])
    open_sky[down] = np.clip(1 - radius**2 * radius / np.linalg.norm(to, axis=1) ** 3, 0, 1)
    return open_sky
