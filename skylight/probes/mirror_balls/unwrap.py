"""Unwrapping of a mirror ball into a lat-long map.

The map is in the frame of the camera that took the picture: its centre shows where the camera
looked (behind the ball), and what stands on the camera's right is right of it. Everything that the
ball mirrors is taken to be far away compared with the ball's size.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.probes.mirror_balls.ball import Ball
from skylight.probes.radiance.probe_map import ProbeMap, averaged, finer_rows, latlong_directions

_MARGIN_PX = 1.5  # inside of the outline, where pixels mix with what is behind the ball
_TABLE = 40_001


@dataclass(frozen=True, kw_only=True)
class BallView:
    """What a ball shows in a picture of linear light.

    ``reflectivity`` is the share of light that the ball throws back, the same at all angles and in
    all colours. (Metal mirrors reflect a little more at grazing angles, near the outline; glass and
    varnish much more: they are no good as probes.)
    """

    radiance: Float[Tensor, "h w 3"]
    clipped: Bool[Tensor, "h w"]
    ball: Ball
    reflectivity: float = 1.0

    @cached_property
    def _deflections(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """(psi, theta): the angles of mirrored direction and of the normal to the view's axis.

        A ray that leaves the camera at the angle b to the axis meets a ball of radius 1 at
        distance D where the normal is theta away from the axis, and leaves at psi::

            tan(b) = sin(theta) / (D - cos(theta)),    psi = 2 theta + b

        up to the outline, where cos(theta) = 1 / D and psi = pi - the ball's angular radius.
        """
        ball, distance = self.ball, self.ball.distance
        theta = np.linspace(0, math.pi / 2 - ball.half_angle_rad, _TABLE)
        tangent = np.sin(theta) / (distance - np.cos(theta))
        inside = tangent < math.tan(ball.half_angle_rad) * (1 - _MARGIN_PX / ball.circle[2])
        return (2 * theta + np.arctan(tangent))[inside], theta[inside]

    def off_axis(self, directions: Float[Tensor, "*s 3"]) -> Float[np.ndarray, "*s"]:
        """psi of directions: 0 towards the camera, pi behind the ball."""
        w = directions.numpy()
        across = np.linalg.norm(np.cross(w, self.ball.axis), axis=-1)
        return np.arctan2(across, w @ -self.ball.axis)

    def places(
        self, directions: Float[Tensor, "*s 3"]
    ) -> tuple[Float[np.ndarray, "*s 2"], Bool[np.ndarray, "*s"]]:
        """(x, y) in px where the ball mirrors each direction (unit, float64), and whether it does.

        A direction in the blind cone gets the place of the nearest one outside.
        """
        towards = -self.ball.axis
        w = directions.numpy()
        psi = self.off_axis(directions)
        table, normals = self._deflections
        theta = np.interp(psi, table, normals)[..., None]
        sideways = w - (w @ towards)[..., None] * towards
        length = np.linalg.norm(sideways, axis=-1, keepdims=True)
        sideways = sideways / np.maximum(length, 1e-12)  # on the axis itself any side will do
        normal = np.cos(theta) * towards + np.sin(theta) * sideways
        points = torch.from_numpy(self.ball.distance * self.ball.axis + normal)
        found = self.ball.camera.project(points.reshape(-1, 3)).numpy()
        return found.reshape(*w.shape[:-1], 2), psi <= table[-1]

    def look_up(
        self, directions: Float[Tensor, "h w 3"]
    ) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
        """(light from each direction, how far it is clipped from 0 to 1, whether it is seen)."""
        points, seen = self.places(directions)
        at = (points - 0.5).astype(np.float32)
        values = cv2.remap(
            np.dstack([self.radiance.numpy(), self.clipped.numpy().astype(np.float32)]),
            at[..., 0],
            at[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return values[..., :3] / self.reflectivity, values[..., 3], seen


def unwrap(view: BallView, height: int) -> ProbeMap:
    """The light round a ball as a lat-long map, averaged down from a finer one."""
    return averaged(*view.look_up(latlong_directions(fine_height(view, height))), height)


def fine_height(view: BallView, height: int) -> int:
    """:func:`~skylight.probes.radiance.probe_map.finer_rows` that hold all that the picture shows.

    A distant ball shows the light towards the camera with radius / 2 px a radian.
    """
    return finer_rows(height, 0.5 * view.ball.circle[2])
