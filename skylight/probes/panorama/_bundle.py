"""Rotations of all shots and the lens, together, by how far matched features are from each other.

With rotations R_i (world from camera), the rays r of a lens (f, k1) and its projection P, the
match of place p in shot i and q in shot j is off by ::

    e = P(R_i^T R_j r(q)) - p,     sum rho(|e|^2) -> min

rho(s) = 2 c^2 (sqrt(1 + s / c^2) - 1), which grows as ``|e|`` does (Brown & Lowe 2007, "Automatic
panoramic image stitching using invariant features", section 4). From the maximum spanning tree
of pairwise turns on; matches are chosen anew, ever nearer, as the lens becomes known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from skylight.imaging._camera_turns import Link
from skylight.probes.panorama._matches import Lens, RotatedLink

Rotations = Mapping[int, Float[np.ndarray, "3 3"]]

# Matches farther off than (the first) do not count, those farther off than (the second) less: px.
_ROUNDS = ((None, 8.0), (12.0, 3.0), (4.0, 1.0), (3.0, 1.0))
# In the beginning those count that agree so far with the turn of their two shots, for a lens that
# is hardly known, and lamps that hints or a tree of turns leave so far apart.
_BEGIN_RAD = 0.15
_HINT_DEG = 2.0  # what hints are wrong by
_K1_SPREAD, _K1_MOST = 0.1, 0.2
_STEP = 1e-5  # of central differences
_STEPS_MOST = 60


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """``rotations`` (world from camera) of the shots that are placed, and what they rest on.

    ``rms_px`` is the root mean square of e (two coordinates) over ``matches`` matches, in pixels
    of ``lens``.
    """

    rotations: dict[int, Float[np.ndarray, "3 3"]]
    lens: Lens
    matches: int
    rms_px: float


def spanning_trees(turned: Sequence[RotatedLink]) -> list[dict[int, Float[np.ndarray, "3 3"]]]:
    """Rotations of each group of shots that hang together, the largest group first.

    Along the maximum spanning tree by number of matches; a group's world is the frame of its shot
    that has most matches.
    """
    count = 1 + max(each.link.end for each in turned)
    matches = np.zeros((count, count))
    by_pair = {}
    for each in turned:
        pair = each.link.start, each.link.end
        matches[pair] = len(each.link.before)
        by_pair[pair] = each.rotation
    _, labels = connected_components(csr_array(matches), directed=False)
    strength = (matches + matches.T).sum(1)
    forest = minimum_spanning_tree(csr_array(-matches))
    groups = []
    for label in np.unique(labels[strength > 0]):
        first = int((strength * (labels == label)).argmax())
        order, before = breadth_first_order(forest, first, directed=False)
        world = {first: np.eye(3)}
        for shot in map(int, order[1:]):
            parent = int(before[shot])
            turn = by_pair[parent, shot] if parent < shot else by_pair[shot, parent].T
            world[shot] = world[parent] @ turn
        groups.append(world)
    return sorted(groups, key=len, reverse=True)


def adjust(
    turned: Sequence[RotatedLink],
    lamps: Sequence[Link],
    start: Rotations,
    lens: Lens,
    hints: Rotations,
) -> Bundle:
    """The bundle of least sum, from these rotations and this lens.

    ``lamps`` are single matches that need not be of the same lamp. ``hints`` are rotations known
    to two degrees or so; without any, one shot stays as it is.
    """
    turned = [each for each in turned if {each.link.start, each.link.end} <= {*start}]
    lamps = [link for link in lamps if {link.start, link.end} <= {*start}]
    shots = sorted(start)
    rotations = np.array([start[shot] for shot in shots])
    number = {shot: place for place, shot in enumerate(shots)}
    problem = _Problem.of([*(each.link for each in turned), *lamps], number)
    known = np.array([shot in hints for shot in shots])
    where = np.array([hints.get(shot, np.eye(3)) for shot in shots])
    agree = np.concatenate([np.zeros(0, bool), *(_agreeing(each, lens) for each in turned)])
    off = np.linalg.norm(problem.errors(rotations, lens), axis=1) / lens.focal_px
    agree = np.concatenate([agree, off[len(agree) :] < _BEGIN_RAD])
    for farthest, width in _ROUNDS:
        if farthest is not None:
            agree = np.linalg.norm(problem.errors(rotations, lens), axis=1) < farthest
        rotations, lens = _Fit(problem.only(agree), rotations, lens, known, where).solve(width)
    error = problem.only(agree).errors(rotations, lens)
    rms_px = float(np.sqrt((error**2).mean())) if len(error) else 0.0
    return Bundle(
        rotations=dict(zip(shots, rotations, strict=True)),
        lens=lens,
        matches=int(agree.sum()),
        rms_px=rms_px,
    )


def _agreeing(turned: RotatedLink, lens: Lens) -> Bool[np.ndarray, " n"]:
    """Which of a link's matches agree with its own turn."""
    error = lens.project(lens.rays(turned.link.after) @ turned.rotation.T) - turned.link.before
    return np.linalg.norm(error, axis=1) < _BEGIN_RAD * lens.focal_px


@dataclass(frozen=True, kw_only=True)
class _Problem:
    """Matches (n,2) of all links in a row, and the shots (n,) they are of."""

    before: Float[np.ndarray, "n 2"]
    after: Float[np.ndarray, "n 2"]
    first: np.ndarray
    second: np.ndarray

    @staticmethod
    def of(links: Sequence[Link], number: Mapping[int, int]) -> "_Problem":
        counts = [len(link.before) for link in links]
        return _Problem(
            before=np.concatenate([np.zeros((0, 2)), *(link.before for link in links)]),
            after=np.concatenate([np.zeros((0, 2)), *(link.after for link in links)]),
            first=np.repeat([number[link.start] for link in links], counts).astype(int),
            second=np.repeat([number[link.end] for link in links], counts).astype(int),
        )

    def only(self, which: Bool[np.ndarray, " n"]) -> "_Problem":
        return _Problem(
            before=self.before[which],
            after=self.after[which],
            first=self.first[which],
            second=self.second[which],
        )

    def directions(
        self, rotations: Float[np.ndarray, "s 3 3"], lens: Lens
    ) -> Float[np.ndarray, "n 3"]:
        """R_j r(q), in the world."""
        return np.einsum("nij,nj->ni", rotations[self.second], lens.rays(self.after))

    def seen(
        self, rotations: Float[np.ndarray, "s 3 3"], lens: Lens, world: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 2"]:
        """e of directions in the world; far off for what is behind the camera."""
        rays = np.einsum("nji,nj->ni", rotations[self.first], world)
        error = lens.project(rays) - self.before
        return np.where(lens.ahead(rays)[:, None], error, 1e4)

    def errors(self, rotations: Float[np.ndarray, "s 3 3"], lens: Lens) -> Float[np.ndarray, "n 2"]:
        return self.seen(rotations, lens, self.directions(rotations, lens))


class _Fit:
    """Least squares over a turn exp(w_i) of each shot from where it is, ln f and k1."""

    def __init__(
        self,
        problem: _Problem,
        rotations: Float[np.ndarray, "s 3 3"],
        lens: Lens,
        known: Bool[np.ndarray, " s"],
        hints: Float[np.ndarray, "s 3 3"],
    ) -> None:
        self.problem, self.start, self.lens = problem, rotations, lens
        self.known, self.hints = known, hints
        # without hints the shot of most matches holds the world
        touched = np.bincount([*problem.first, *problem.second], minlength=len(rotations))
        self.held = None if known.any() else int(touched.argmax())

    def solve(self, width: float) -> tuple[Float[np.ndarray, "s 3 3"], Lens]:
        begin = np.zeros(3 * len(self.start) + 2)
        begin[-2:] = np.log(self.lens.focal_px), self.lens.k1
        far = np.full(len(begin), np.inf)
        far[-2] = begin[-2] + np.log(3.0)
        far[-1] = _K1_MOST
        low = -far
        low[-2] = begin[-2] - np.log(3.0)
        found = least_squares(
            self._residuals,
            begin,
            jac=self._jacobian,  # type: ignore[arg-type]
            bounds=(low, far),
            loss="soft_l1",
            f_scale=width,
            x_scale=np.concatenate([np.full(len(begin) - 2, 0.01), [0.01, 0.01]]),
            tr_solver="lsmr",
            max_nfev=_STEPS_MOST,
        )
        return self._rotations(found.x), self._lens(found.x)

    def _rotations(self, free: Float[np.ndarray, " q"]) -> Float[np.ndarray, "s 3 3"]:
        turns = Rotation.from_rotvec(free[:-2].reshape(-1, 3)).as_matrix()
        return turns @ self.start

    def _lens(self, free: Float[np.ndarray, " q"]) -> Lens:
        return replace(self.lens, focal_px=float(np.exp(free[-2])), k1=float(free[-1]))

    def _off_hints(self, rotations: Float[np.ndarray, "s 3 3"]) -> Float[np.ndarray, "h 3"]:
        """Of the shots with hints, in standard deviations."""
        known = self.known
        apart = rotations[known] @ self.hints[known].transpose(0, 2, 1)
        return np.degrees(Rotation.from_matrix(apart).as_rotvec().reshape(-1, 3)) / _HINT_DEG

    def _residuals(self, free: Float[np.ndarray, " q"]) -> Float[np.ndarray, " e"]:
        rotations = self._rotations(free)
        error = self.problem.errors(rotations, self._lens(free))
        off = self._off_hints(rotations)
        return np.concatenate([error.ravel(), off.ravel(), [free[-1] / _K1_SPREAD]])

    def _jacobian(self, free: Float[np.ndarray, " q"]) -> csr_array:
        problem, rotations, lens = self.problem, self._rotations(free), self._lens(free)
        n, s = len(problem.before), len(rotations)
        world = problem.directions(rotations, lens)
        by_turn = np.empty((n, 2, 3))  # of the second shot; of the first it is the negative
        for axis in range(3):
            step = _STEP * np.cross(np.eye(3)[axis], world)
            ahead, back = (problem.seen(rotations, lens, world + k * step) for k in (1, -1))
            by_turn[..., axis] = (ahead - back) / (2 * _STEP)
        left = _left_jacobian(free[:-2].reshape(-1, 3))
        rows = np.repeat(np.arange(2 * n).reshape(n, 2, 1), 3, 2)
        parts = []
        for shots, sign in ((problem.first, -1.0), (problem.second, 1.0)):
            columns = np.broadcast_to((3 * shots[:, None] + np.arange(3))[:, None], by_turn.shape)
            parts.append((sign * by_turn @ left[shots], rows, columns))
        for column in (3 * s, 3 * s + 1):
            step = np.zeros(len(free))
            step[column] = _STEP
            ahead, back = (problem.errors(rotations, self._lens(free + k * step)) for k in (1, -1))
            slope = (ahead - back) / (2 * _STEP)
            parts.append((slope, rows[..., 0], np.full((n, 2), column)))
        # d(off)/dw, whose product with off is exact: what is left out turns about off itself
        hinted = np.flatnonzero(self.known)
        each = 3 * np.arange(len(hinted))[:, None, None] + np.arange(3)[:, None] + np.zeros(3, int)
        columns = np.broadcast_to((3 * hinted[:, None] + np.arange(3))[:, None], each.shape)
        parts.append((np.degrees(1) / _HINT_DEG * left[hinted], 2 * n + each, columns))
        count = 2 * n + 3 * len(hinted)
        parts.append((np.array([1 / _K1_SPREAD]), np.array([count]), np.array([3 * s + 1])))
        values, at, to = (np.concatenate([np.ravel(p[k]) for p in parts]) for k in range(3))
        if self.held is not None:
            values = np.where(to // 3 == self.held, 0.0, values)
        return csr_array((values, (at, to)), shape=(count + 1, len(free)))


def _left_jacobian(w: Float[np.ndarray, "s 3"]) -> Float[np.ndarray, "s 3 3"]:
    """J with exp(w + d) = exp(J d) exp(w) to first order in d."""
    angle = np.maximum(np.linalg.norm(w, axis=1), 1e-8)[:, None, None]
    zero = np.zeros(len(w))
    x, y, z = w.T
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
    first = 2 * np.sin(angle / 2) ** 2 / angle**2
    second = np.where(angle > 1e-3, (angle - np.sin(angle)) / angle**3, 1 / 6)
    return np.eye(3) + first * cross + second * cross @ cross
