"""A light probe from merged exposures of a mirror ball or of a 360-degree camera.

A ball is unwrapped into a lat-long map in the frame of the camera that took the picture: its centre
shows where the camera looked (behind the ball), and what stands on the camera's right is right of
it. Everything that the ball mirrors is taken to be far away compared with the ball's size. Of two
views, each fills in the camera and the blind cone of the other.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from torch import Tensor

from skylight._names import MergedFrom
from skylight.errors import InputError
from skylight.probes._probe_map import ProbeMap, averaged, finer_rows, latlong_directions
from skylight.probes.cameras._exposures import Clipping, ExposureSeries, find_clipping
from skylight.probes.mirror_balls._ball import (
    Ball,
    Outline,
    ball_of_circle,
    find_ball,
    focal_from_fov,
    picture_camera,
)
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angle_between, rotation_about

_MARGIN_PX = 1.5  # inside of the outline, where pixels mix with what is behind the ball
_TABLE = 40_001
TURN_DEG = 90.0
_MATCH_ROWS = 64
_NEAR_DEG = 25.0  # how far off the stated turn is still taken for it
_ALIKE_MIN = 0.3  # correlation below which two views do not tell their turn
_UNALIKE = 0.2  # in ln: from there on, what differs is not the turn but nearness or movement
_POWER = 8
Circle = tuple[float, float, float]


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
    """:func:`~skylight.probes._probe_map.finer_rows` that hold all that the picture shows.

    A distant ball shows the light towards the camera with radius / 2 px a radian.
    """
    return finer_rows(height, 0.5 * view.ball.circle[2])


@dataclass(frozen=True, kw_only=True)
class Turn:
    """Pose of the second camera relative to the first.

    ``rotation``     turns directions of the second camera's frame into the first's.
    ``azimuth_deg``  where the second camera looked in the first one's frame, + to the right.
    ``gain``         how much brighter the first view shows the same light.
    ``correlation``  of the logarithms of light in both; None where the turn was taken as given.
    """

    rotation: Float[Tensor, "3 3"]
    azimuth_deg: float
    gain: float
    correlation: float | None


def match_views(first: BallView, second: BallView, turn_deg: float = TURN_DEG) -> Turn:
    """The turn between two views, by what both show.

    The best correlation of log luminance over azimuths within 25 degrees of ``turn_deg`` or, the
    camera having gone the other way round, of its opposite, starts a robust least-squares search
    over all rotations. Where it stays below 0.3, the turn is taken as given.
    """
    a, b = (_log_map(view) for view in (first, second))
    width = 2 * _MATCH_ROWS
    azimuths = np.arange(width) * 360.0 / width
    off = np.minimum(*(np.abs((azimuths - s * turn_deg + 180) % 360 - 180) for s in (1, -1)))
    near = azimuths[off <= _NEAR_DEG]
    trials = [_correlation(a, b.rotate_azimuth(math.radians(azimuth))) for azimuth in near]
    start = math.radians(float(near[int(np.argmax(trials))]))
    found = least_squares(
        lambda vector: _differences(a, b, _rotation(vector)),
        [0.0, -start, 0.0],
        loss="soft_l1",
        f_scale=_UNALIKE,
        diff_step=1e-3,
        xtol=1e-4,
        max_nfev=25,
    )
    rotation = _rotation(found.x)
    correlation = _correlation(a, b.rotate(rotation))
    if correlation < _ALIKE_MIN:
        up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
        given = rotation_about(up, -math.radians(turn_deg))
        return Turn(rotation=given, azimuth_deg=turn_deg, gain=1.0, correlation=None)
    looks = rotation @ torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
    return Turn(
        rotation=rotation,
        azimuth_deg=math.degrees(math.atan2(looks[0], -looks[2])),
        gain=math.exp(_offset(a, b.rotate(rotation))),
        correlation=correlation,
    )


def blend(first: BallView, second: BallView, turn: Turn, height: int) -> ProbeMap:
    """One map in the first camera's frame, weighted by sin(psi)^8 of each view.

    psi is the angle to the camera as seen from the ball. The weight vanishes towards the camera,
    with whoever stands behind it, and behind the ball, where the mirrored picture is squeezed into
    the outline; with a turn of a quarter one view is at its best there.
    """
    fine = max(fine_height(first, height), fine_height(second, height))
    directions = latlong_directions(fine)
    light, clipped, seen = first.look_up(directions)
    turned = directions @ turn.rotation  # rows w^T R = (R^T w)^T
    other_light, other_clipped, other_seen = second.look_up(turned)
    one = _weight(first, directions, seen)
    two = _weight(second, turned, other_seen)
    # where neither shows anything, both show what is nearest
    none = one + two == 0
    share = np.where(none, 0.5, one / np.where(none, 1, one + two)).astype(np.float32)
    return averaged(
        share[..., None] * light + (1 - share)[..., None] * turn.gain * other_light,
        share * clipped + (1 - share) * other_clipped,
        seen | other_seen,
        height,
    )


def camera_distance_deg(turn: Turn) -> float:
    """Angle between where the two cameras looked, in degrees."""
    ahead = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
    return math.degrees(float(angle_between(turn.rotation @ ahead, ahead)))


def _weight(view: BallView, directions: Float[Tensor, "h w 3"], seen: np.ndarray) -> np.ndarray:
    return np.sin(view.off_axis(directions)) ** _POWER * seen


def _log_map(view: BallView) -> EnvironmentMap:
    """Channels: log luminance times weight, weight, nothing."""
    fine = fine_height(view, _MATCH_ROWS)
    light, clipped, seen = view.look_up(latlong_directions(fine))
    smooth = averaged(light, clipped, seen, _MATCH_ROWS)
    value = luminance(smooth.environment.flat).double()
    logs = torch.log(value + 1e-3 * value.mean() + 1e-30)
    grid = smooth.environment.grid
    # the camera's surroundings and the blind cone differ between views
    weight = torch.from_numpy(np.sin(view.off_axis(grid.directions)) ** 2)
    flat = torch.stack([logs * weight, weight, torch.zeros_like(weight)], -1)
    return EnvironmentMap(radiance=flat.reshape(_MATCH_ROWS, -1, 3))


def _pair(
    a: EnvironmentMap, b: EnvironmentMap
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Log luminance of both, and how much each pixel counts (sum 1)."""
    weight = a.flat[:, 1] * b.flat[:, 1] * a.grid.solid_angles
    logs = [each.flat[:, 0] / each.flat[:, 1].clamp(min=1e-9) for each in (a, b)]
    return logs[0], logs[1], weight / weight.sum()


def _correlation(a: EnvironmentMap, b: EnvironmentMap) -> float:
    one, two, weight = _pair(a, b)
    one, two = one - weight @ one, two - weight @ two
    spread = (weight @ one**2) * (weight @ two**2)
    return float(weight @ (one * two) / spread.clamp(min=1e-30).sqrt())


def _offset(a: EnvironmentMap, b: EnvironmentMap) -> float:
    """Median of the difference of logarithms over what both show well."""
    one, two, weight = _pair(a, b)
    order = torch.argsort(one - two)
    half = int(torch.searchsorted(torch.cumsum(weight[order], 0), 0.5))
    return float((one - two)[order[half]])


def _differences(
    a: EnvironmentMap, b: EnvironmentMap, rotation: Float[Tensor, "3 3"]
) -> np.ndarray:
    one, two, weight = _pair(a, b.rotate(rotation))
    difference = one - two
    return ((difference - weight @ difference) * (len(weight) * weight).sqrt()).numpy()


def _rotation(vector: np.ndarray) -> Float[Tensor, "3 3"]:
    return torch.from_numpy(Rotation.from_rotvec(vector).as_matrix())


@dataclass(frozen=True, kw_only=True)
class MergedProbe:
    """All that was found. ``outlines``, ``turn`` and ``fov_deg`` are of balls alone.

    An outline's support is None where it was given; ``fov_deg`` (vertical) is None where nothing
    tells it.
    """

    kind: MergedFrom
    probe: ProbeMap
    views: tuple[ExposureSeries, ...]
    outlines: tuple[Outline, ...] = ()
    turn: Turn | None = None
    clipping: Clipping | None
    reflectivity: float
    fov_deg: float | None = None


@dataclass(frozen=True, kw_only=True)
class BallOptions:
    """How a mirror ball was photographed.

    ``circles``       (x, y, radius) of its outline in px in each view; None where to search.
    ``fov_deg``       vertical field of view; None where EXIF data may tell.
    ``turn_deg``      about how far apart the two cameras looked.
    ``reflectivity``  share of light that the ball throws back.
    """

    circles: tuple[Circle | None, Circle | None] = (None, None)
    fov_deg: float | None = None
    turn_deg: float = TURN_DEG
    reflectivity: float = 1.0


def merged_from_360(view: ExposureSeries, height: int) -> MergedProbe:
    """Of a camera whose picture is the lat-long map already."""
    merged = view.merged
    rows, columns = merged.radiance.shape[:2]
    if columns != 2 * rows:
        raise InputError(
            f"{view.files[0]}: {columns}x{rows} pixels; a 360-degree picture is a lat-long "
            "map, twice as wide as high: export it so, or give --kind ball"
        )
    seen = np.ones((rows, columns), bool)
    clipped = merged.clipped.numpy().astype(np.float32)
    probe = averaged(merged.radiance.numpy(), clipped, seen, height)
    return MergedProbe(
        kind="360",
        probe=probe,
        views=(view,),
        clipping=find_clipping(probe),
        reflectivity=1.0,
    )


def merged_from_ball(
    views: tuple[ExposureSeries, ...], options: BallOptions, height: int
) -> MergedProbe:
    """Of one view of a mirror ball, or of two from different sides."""
    found = [
        _ball_view(shots, circle, options)
        for shots, circle in zip(views, options.circles, strict=False)
    ]
    balls = [view for view, _ in found]
    turn = None
    if len(balls) == 1:
        probe = unwrap(balls[0], height)
    else:
        turn = match_views(balls[0], balls[1], options.turn_deg)
        probe = blend(balls[0], balls[1], turn, height)
    known = options.fov_deg is not None or views[0].focal_px is not None
    camera = balls[0].ball.camera
    fov_deg = 2 * math.degrees(math.atan(camera.height / (2 * camera.focal_px)))
    return MergedProbe(
        kind="ball",
        probe=probe,
        views=views,
        outlines=tuple(outline for _, outline in found),
        turn=turn,
        clipping=find_clipping(probe),
        reflectivity=options.reflectivity,
        fov_deg=fov_deg if known else None,
    )


def _ball_view(
    shots: ExposureSeries, circle: Circle | None, options: BallOptions
) -> tuple[BallView, Outline]:
    merged = shots.merged
    height, width = merged.radiance.shape[:2]
    focal_px = shots.focal_px
    if options.fov_deg is not None:
        focal_px = focal_from_fov(height, options.fov_deg)
    camera = picture_camera(height, width, focal_px)
    if circle is None:
        outline = find_ball(merged.radiance, camera)
    else:
        outline = Outline(ball=ball_of_circle(camera, *circle), support=None)
    view = BallView(
        radiance=merged.radiance,
        clipped=merged.clipped,
        ball=outline.ball,
        reflectivity=options.reflectivity,
    )
    return view, outline
