"""Two views of a ball blended: each fills in the camera and the blind cone of the other."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from torch import Tensor

from skylight.probes.mirror_balls.unwrap import BallView, fine_height
from skylight.probes.radiance.probe_map import ProbeMap, averaged, latlong_directions
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.frame import angle_between, rotation_about

TURN_DEG = 90.0
_MATCH_ROWS = 64
_NEAR_DEG = 25.0  # how far off the stated turn is still taken for it
_ALIKE_MIN = 0.3  # correlation below which two views do not tell their turn
_UNALIKE = 0.2  # in ln: from there on, what differs is not the turn but nearness or movement
_POWER = 8


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
