"""The light on the points of a head, in a few milliseconds: one main light in ambient light.

In the head's frame, of luminances y (over their mean, and over the albedo) at points p::

    y_p = b (B c)_p + E t_p(d) + e_p,    c ~ N(mu, S),    E ~ N(0, s^2), E >= 0,    e ~ N(0, Q)

with B the transport of harmonics, c the ambient light of level b, t(d) the transport of a lobe
towards direction d, and errors e: pigments times the shading, fields of wrong shape, and noise of
each point, heavy-tailed (Student's t as a scale mixture: what no light on skin explains loses
weight, Lange, Little & Taylor 1989). Given b and d all is normal but for the sign of E, and the
evidence has a closed form. With ``K = b^2 B S B^T + Q`` and ``z = y - b B mu``::

    ln p(y | b, d) = -1/2 (z^T K^-1 z + ln|K|) - 1/2 ln(1 + s^2 A) + 1/2 m C + ln 2 Phi(m / v)

    A = t^T K^-1 t,  C = t^T K^-1 z,  m = s^2 C / (1 + s^2 A),  v^2 = s^2 / (1 + s^2 A),

m and v^2 being the moments of E without its sign. K is diagonal plus 59 columns U, so that all of
2,048 directions at three levels take one product of 59 x p by p x 2,048. What is found is a mean
over all (b, d), so that it moves as smoothly as the picture.

Beside an estimate (:mod:`skylight.inverse`) it leaves out reflection by the skin's surface,
interreflection, lamps beyond the first, which count as ambient light, and every albedo but the mean
person's. ``docs/live.md`` has how far both are off. Where the main light does not reach the face,
:attr:`LightSolution.radius_90_rad` is large.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.special import log_ndtr

from skylight.faces._skin import SkinPrior
from skylight.live._head import SkinPoints
from skylight.live._prior import DEGREE, ambient_moments, pigments, shape_errors
from skylight.sphere._envmap import LUMINANCE
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._harmonics import evaluate
from skylight.sphere._rotation import rotate

# Set by 18 rendered people in simulated places:
LEVELS = (0.1, 0.3, 0.6)  # b, as the part of the face that the ambient prior's mean explains
NOISE, LEAST_NOISE_AT = 0.12, 0.4  # of a point, as part of its shading plus this
DEGREES_OF_FREEDOM = 4.0
MOST_SHADING = 4.0  # over the mean: a highlight's is no shading
LEAST_OF_CHANNEL = 0.05  # of the main light's luminance: lamps have all colours
LAMP_SPREAD = 2 * math.pi  # s: of the main light's irradiance, over the albedo and the mean
UPWARDS = 0.8  # ln of how much likelier light from above is than from ahead: lamps of rooms
TRUST = 0.4  # the power of the evidence: the errors' model is not the errors
LOBE_RAD = math.radians(8.0)  # a lamp's width in a room
# The light is a mean by this power of the density: the density itself also has what is behind the
# head, where any lamp might be
SHARPER = 2
CREDIBLE = 0.9
# The cap that holds nine of ten errors of the head's pose, which is taken as known here: 3.4
# degrees (root mean square, 18 rendered people) times sqrt(ln 10)
POSE_RAD = math.radians(5.2)
ALL_CHANNELS = np.column_stack([LUMINANCE, np.eye(3)])  # the luminance, then each channel


@dataclass(frozen=True, kw_only=True)
class LightSolution:
    """Light in the camera's frame, linear Rec.709 in units of the picture's white.

    ``density`` (n,) over the *head's* directions sums to 1. By its square, ``direction``,
    ``irradiance`` (3,) of the main light, and harmonics of ``ambient`` (k,3) radiance and of all
    light, ``harmonics`` (9,3), are means. ``radius_90_rad`` is the radius of the cap about the
    direction that holds :data:`CREDIBLE` of the density, and of the pose's errors.
    """

    density: Float[ndarray, " n"]
    direction: Float[ndarray, "3"]
    radius_90_rad: float
    irradiance: Float[ndarray, "3"]
    ambient: Float[ndarray, "k 3"]
    harmonics: Float[ndarray, "9 3"]


def head_from_camera(camera_from_head: Float[ndarray, "3 3"]) -> Float[ndarray, "k k"]:
    """The matrix of harmonics' coefficients that L_head(w) = L_camera(R w) makes; orthogonal."""
    unit = torch.eye((DEGREE + 1) ** 2, dtype=torch.float64)
    return rotate(unit, torch.from_numpy(camera_from_head.T.copy())).T.numpy()


def lobes_on(
    grid: DirectionGrid, towards: Float[ndarray, "k 3"], width_rad: float
) -> Float[ndarray, "n k"]:
    """``exp((<w, t> - 1) / width^2)`` about each of the directions t, whose integral on the grid
    is 1."""
    lobes = np.exp((grid.directions.numpy() @ towards.T - 1) / width_rad**2)
    return lobes / (grid.solid_angles.numpy() @ lobes)


class LightSolver:
    """Light on one person's head. What points are worth is remembered from frame to frame."""

    def __init__(self, skin: SkinPoints) -> None:
        self._directions = skin.grid.directions.numpy()
        self._solid_angles = skin.grid.solid_angles.numpy()
        self._harmonics = evaluate(skin.grid.directions, DEGREE).numpy()
        self._basis = skin.transport @ self._harmonics
        lobes = lobes_on(skin.grid, self._directions, LOBE_RAD)
        self._towards = (skin.transport @ lobes).astype(np.float32)
        self._inlier = np.ones(len(skin.vertices))
        self._shading: Float[ndarray, " p"] | None = None
        self._albedo = SkinPrior.load().mean.numpy()

    def solve(
        self,
        colours: Float[ndarray, "p 3"],
        weights: Float[ndarray, " p"],
        camera_from_head: Float[ndarray, "3 3"],
    ) -> LightSolution:
        """The light of colours that count ``weights`` (0: not seen), of one frame.

        Of the first frame the weights of outliers are found by three rounds, then by one each.
        """
        mean = weights @ colours / weights.sum()
        y = colours @ ALL_CHANNELS / np.maximum(mean @ ALL_CHANNELS, 1e-9)
        up = UPWARDS * (self._directions @ camera_from_head[1])
        turning = head_from_camera(camera_from_head)
        for _ in range(3 if self._shading is None else 1):
            problem = self.problem(y, weights, turning)
            levels = [problem.at(share) for share in LEVELS]
            joint = TRUST * np.array([level.evidence for level in levels]) + up
            joint = np.exp(joint - joint.max()) * self._solid_angles
            joint /= joint.sum()
            density = joint.sum(0)
            sharp = density**SHARPER / (density**SHARPER).sum()
            # channels have levels of their own, as colours of lamps and rooms differ
            peak = int(density.argmax())
            likely = TRUST * np.array([level.evidence_at(peak) for level in levels])
            likely = np.exp(likely - likely.max(0))
            likely /= likely.sum(0)
            explained = [
                level.explained(sharp[:, None] * of_channels)
                for level, of_channels in zip(levels, likely, strict=True)
            ]
            main, ambient, shading, errors = (
                np.sum(parts, axis=0) for parts in zip(*explained, strict=True)
            )
            self._shading = np.clip(shading, 0, MOST_SHADING)
            nu = DEGREES_OF_FREEDOM
            self._inlier = np.minimum((nu + 1) / (nu + (errors / problem.noise) ** 2), 1)
        main, ambient = (each[:, 1:] * (mean / self._albedo) for each in (main, ambient))
        every = ambient.copy()
        every[:9] += self._harmonics[:, :9].T @ main
        middle = sharp @ self._directions
        direction = middle / max(float(np.linalg.norm(middle)), 1e-12)
        return LightSolution(
            density=density,
            direction=camera_from_head @ direction,
            radius_90_rad=self._radius(density, direction),
            irradiance=main.sum(0),
            ambient=turning.T @ ambient,
            harmonics=(turning.T @ every)[:9],
        )

    def problem(
        self,
        y: Float[ndarray, "p 4"],
        weights: Float[ndarray, " p"],
        turning: Float[ndarray, "k k"],
    ) -> "Problem":
        """What all levels of the ambient light have in common; y is luminance and channels."""
        shading = np.clip(y[:, 0], 0, MOST_SHADING) if self._shading is None else self._shading
        noise = NOISE * (shading + LEAST_NOISE_AT)
        mean, root = (turning @ each for each in ambient_moments())
        even = self._basis @ mean
        ambient = self._basis @ root
        return Problem(
            y=y,
            noise=noise,
            precision=weights / weights.max() * self._inlier / noise**2,
            towards=self._towards,
            ways=np.concatenate([ambient, shading[:, None] * pigments(), shape_errors()], 1),
            mean=mean,
            root=root,
            even=even,
            even_level=float(weights @ even / weights.sum()),
        )

    def _radius(self, density: Float[ndarray, " n"], middle: Float[ndarray, "3"]) -> float:
        cosines = self._directions @ middle
        order = np.argsort(-cosines)
        reached = int(np.searchsorted(np.cumsum(density[order]), CREDIBLE))
        cosine = float(np.clip(cosines[order[min(reached, len(order) - 1)]], -1, 1))
        return min(math.hypot(math.acos(cosine), POSE_RAD), math.pi)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One frame's: y (p,4) with noise of precision (p,) about ``even`` b = (B mu) b, the ways U.

    ``ways`` (p,u) are first B times ``root`` of S, which the level scales, then those of errors.
    """

    y: Float[ndarray, "p 4"]
    noise: Float[ndarray, " p"]
    precision: Float[ndarray, " p"]
    towards: Float[ndarray, "p n"]
    ways: Float[ndarray, "p u"]
    mean: Float[ndarray, " k"]
    root: Float[ndarray, "k k"]
    even: Float[ndarray, " p"]
    even_level: float

    @cached_property
    def weighted(self) -> Float[ndarray, "p u"]:
        return self.precision[:, None] * self.ways

    @cached_property
    def gram(self) -> Float[ndarray, "u u"]:
        return self.ways.T @ self.weighted

    @cached_property
    def across(self) -> Float[ndarray, "u n"]:
        return self.weighted.T.astype(np.float32) @ self.towards

    @cached_property
    def alone(self) -> Float[ndarray, " n"]:
        return self.precision.astype(np.float32) @ self.towards**2

    @cached_property
    def seen(self) -> Float[ndarray, "p 5"]:
        """y and what even light adds, of which every z is a combination."""
        return np.column_stack([self.y, self.even])

    @cached_property
    def along(self) -> Float[ndarray, "5 n"]:
        return (self.precision[:, None] * self.seen).T.astype(np.float32) @ self.towards

    def at(self, share: float) -> "Level":
        """With ambient light whose prior mean makes such a share of the face's mean."""
        level, known = share / self.even_level, len(self.mean)
        scale = np.ones(self.ways.shape[1])
        scale[:known] = level
        factor = np.linalg.cholesky(np.eye(len(scale)) + scale[:, None] * self.gram * scale)
        lower = np.linalg.inv(factor) * scale  # u is small
        of_y = np.concatenate([np.eye(4), np.full((1, 4), -level)])
        z = self.seen @ of_y
        inside = lower @ (self.weighted.T @ z)
        seen = lower.astype(np.float32) @ self.across
        c = (of_y.T @ self.along - inside.T.astype(np.float32) @ seen).astype(np.float64)
        a = np.maximum(self.alone - (seen**2).sum(0), 1e-9).astype(np.float64)
        return Level(
            problem=self,
            level=level,
            z=z,
            lower=lower,
            inside=inside,
            along=c,
            across=a,
            without=self.precision @ z**2 - (inside**2).sum(0),
            log_factor=float(np.log(np.diag(factor)).sum()),
        )


@dataclass(frozen=True, kw_only=True)
class Level:
    """A problem at one level b of ambient light.

    ``lower`` is L^-1 diag(b, 1) with ``L L^T = 1 + U^T W U``; ``along`` (4,n) and ``across`` (n,)
    are C and A of the module's text, of luminance and channels, and ``without`` (4,) z^T K^-1 z.
    """

    problem: Problem
    level: float
    z: Float[ndarray, "p 4"]
    lower: Float[ndarray, "u u"]
    inside: Float[ndarray, "u 4"]
    along: Float[ndarray, "4 n"]
    across: Float[ndarray, " n"]
    without: Float[ndarray, "4"]
    log_factor: float

    @cached_property
    def evidence(self) -> Float[ndarray, " n"]:
        """ln p(y | b, d) of the luminance for a main light from each direction, but a constant."""
        return self._evidence(self.along[0], self.across, float(self.without[0]))

    def evidence_at(self, direction: int) -> Float[ndarray, "4"]:
        """That of luminance and channels in one direction."""
        return self._evidence(self.along[:, direction], float(self.across[direction]), self.without)

    def _evidence(
        self,
        c: Float[ndarray, " n"],
        a: float | Float[ndarray, " n"],
        without: float | Float[ndarray, " n"],
    ) -> Float[ndarray, " n"]:
        m, v, gain = _lamp(c, a)
        return 0.5 * (m * c - np.log(gain) - without) + log_ndtr(m / v) - self.log_factor

    @property
    def strength(self) -> Float[ndarray, "4 n"]:
        """Mean irradiance E from each direction: of a normal that is cut off at 0."""
        m, v, _ = _lamp(self.along, self.across)
        ratio = m[0] / v
        # m + v phi / Phi of the luminance; what is added is added to each channel
        cut = v * np.exp(-0.5 * (ratio**2 + math.log(2 * math.pi)) - log_ndtr(ratio))
        return np.maximum(m + cut, LEAST_OF_CHANNEL * (m[0] + cut))

    def explained(
        self, shares: Float[ndarray, "n 4"]
    ) -> tuple[
        Float[ndarray, "n 4"], Float[ndarray, "k 4"], Float[ndarray, " p"], Float[ndarray, " p"]
    ]:
        """(main light, ambient light, shading, what is left), of directions that have a share.

        All are sums over directions: of all levels they add up to means. ``found``, the mean of
        the ways' amounts, has the level in it already, as ``lower`` has.
        """
        problem, likely, known = self.problem, shares.sum(0), len(self.problem.mean)
        main = shares * self.strength.T
        lit = problem.towards @ main.astype(np.float32)
        found = self.lower.T @ (likely * self.inside - self.lower @ (problem.weighted.T @ lit))
        ambient = self.level * likely * problem.mean[:, None] + problem.root @ found[:known]
        errors = likely[0] * self.z[:, 0] - lit[:, 0] - problem.ways @ found[:, 0]
        of_ambient = problem.ways[:, :known] @ found[:known, 0]
        shading = likely[0] * self.level * problem.even + of_ambient + lit[:, 0]
        return main, ambient, shading, errors


def _lamp(
    c: Float[ndarray, "*k n"], a: float | Float[ndarray, " n"]
) -> tuple[Float[ndarray, "*k n"], float | Float[ndarray, " n"], float | Float[ndarray, " n"]]:
    """(m, v, 1 + s^2 A) of the module's text: E without its sign."""
    gain = 1 + LAMP_SPREAD**2 * a
    return LAMP_SPREAD**2 * c / gain, LAMP_SPREAD / np.sqrt(gain), gain
