"""Where could the sun be? One small non-negative least-squares problem per direction.

For every direction d above the horizon, and for a lamp at the camera, the face's luminance is
explained by light from there alone, scattered (T) and mirrored by the surface (G), plus about
twenty broad ambient lobes over the sphere, all non-negative::

    min_{a, g, b >= 0}  sum_p w_p (y_p - a T[p, d] - g G[p, d] - sum_j b_j (T A)[p, j])^2

The directions with the smallest residuals initialise the non-linear optimisation.

Of a fitted head the normals are not known. Where they may be turned by errors M u with u standard
normal (:mod:`skylight.transport._normal_modes`), y_p is explained by what that adds too, for a
price::

    min_{a, g, b >= 0, u}  sum_p w_p (y_p - ... - <M_p u, F_p>)^2 + c (sum_p w_p) m^2 |u|^2,

m being the mean of y and F the light vector in the light that explains y without (and then once
more with) u. Heads with flatter cheeks than the person has made suns at the side come from the
front.

Several faces under one light have a problem each, since each has its own albedo and exposure.
Energies relative to the face's own add up: each face counts alike, as in the objective.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from skylight.inverse._least_squares import nnls
from skylight.inverse._sun_prior import SunPrior
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._observation import Observation

SCAN_HEIGHT = 32
LOBES = 20
BOUND_UPDATES = 3
LIKELY = 4  # candidates where clock and place tell of the sun
# c: u counts as if pixels deviated by 0.2 of the mean and 250 of them were independent. The mean
# error of the scan's sun on rendered people depends on it little: 11.0 to 11.3 degrees from a
# deviation of 0.1 to one of 0.7 (11.2 with normals trusted); the median prefers 0.2 and less.
NORMAL_COST = 0.2**2 / 250
NORMAL_ROUNDS = 2
FURTHER = 512  # directions that leave least, whose normals are turned in a first scan
_BLOCK = 32  # directions at a time on a CPU, whose cache holds so many of pixels x modes


@dataclass(frozen=True, kw_only=True)
class SunScan:
    """Relative residual per direction, and the best directions that lie apart.

    ``residuals`` (n,) are sqrt(min / sum w y^2) for each of ``directions`` (n,3), the root mean
    square where there are several faces; ``candidates`` (k,3) the best in order, each 12 degrees
    or more from the better ones (not necessarily local minima), and then the best of those that
    are likely beforehand; ``strengths`` (k,) the share of the diffuse shading that the sun
    explains in each, a mean over the faces.
    """

    directions: Float[Tensor, "n 3"]
    residuals: Float[Tensor, " n"]
    candidates: Float[Tensor, "k 3"]
    strengths: Float[Tensor, " k"]

    @staticmethod
    def of(
        faces: "Sequence[FaceScan]",
        *,
        candidates: int = 4,
        separation_deg: float = 12.0,
        sun_prior: SunPrior | None = None,
    ) -> "SunScan":
        """What the scans of faces under one light tell together, on the CPU.

        The faces may have any albedos and exposures. Candidates are ``separation_deg`` apart;
        up to :data:`LIKELY` more are where ``sun_prior`` says that the sun may stand.
        """
        energy = torch.stack([face.unexplained for face in faces]).mean(0)
        strength = torch.stack([face.strengths for face in faces]).mean(0)
        residuals = energy.sqrt().cpu()
        directions = DirectionGrid.latlong(SCAN_HEIGHT).directions[: len(residuals)]
        apart = math.radians(separation_deg)
        chosen = best_apart(directions, residuals, candidates, apart)
        if sun_prior is not None:
            elsewhere = torch.where(sun_prior.likely(directions), residuals, torch.inf)
            chosen = best_apart(directions, elsewhere, len(chosen) + LIKELY, apart, chosen)
        return SunScan(
            directions=directions,
            residuals=residuals,
            candidates=directions[chosen],
            strengths=strength.cpu()[chosen],
        )


@dataclass(frozen=True, kw_only=True)
class FaceScan:
    """The problem above for one face.

    ``unexplained`` (n,) the share of sum w y^2 that is left with the sun in each direction,
    ``without_sun`` that without any sun, ``camera_lit`` that with a lamp at the camera instead;
    ``strengths`` (n,) the sun's share of the diffuse shading; ``deviations`` (m,) luminance seen
    minus that of the best explanation; ``solution`` (n+2,k) the unknowns, from which another scan
    of the face may start.
    """

    unexplained: Float[Tensor, " n"]
    without_sun: float
    camera_lit: float
    strengths: Float[Tensor, " n"]
    deviations: Float[Tensor, " m"]
    solution: Float[Tensor, "n_2 k"]

    def rows(self, likeliest: int | None) -> Int[Tensor, " j"]:
        """Those of the solution that are of so many directions that leave least, or of all."""
        count = len(self.unexplained)
        best = self.unexplained.argsort()[:likeliest].sort().values
        return torch.cat([best, best.new_tensor([count, count + 1])])

    def onto(self, before: "FaceScan", rows: Int[Tensor, " j"]) -> "FaceScan":
        """A scan of all directions, of which this one is of those rows."""

        def whole(name: str, rows: Int[Tensor, " j"]) -> Tensor:
            return getattr(before, name).index_copy(0, rows, getattr(self, name))

        return replace(
            self,
            unexplained=whole("unexplained", rows[:-2]),
            strengths=whole("strengths", rows[:-2]),
            solution=whole("solution", rows),
        )


def scan_faces(
    observations: Sequence[Observation],
    *,
    sphere: bool = False,
    at_once: int | None = None,
    before: "Sequence[FaceScan] | None" = None,
    likeliest: int | None = None,
) -> list[FaceScan]:
    """Explain each face by a sun in each direction, and by ambient light alone.

    Directions are the 1,024 of the upper half of a 32 x 64 grid, or all of it with ``sphere``. Each
    face is solved on the device of its observation, ``at_once`` faces together; its scan is the
    same but for rounding. By default one on the CPU, whose cache holds the unknowns of one (4 MB),
    and all on other devices, which are idle otherwise.

    ``before``: scans of the same faces with other weights. Of faces whose normals may be wrong
    they are as good a start as what explains them without, and take half the time. Then so many
    of the ``likeliest`` directions may be scanned alone; the others stay as they were.
    """
    if at_once is None:
        on_cpu = observations[0].weights.device.type == "cpu"
        at_once = 1 if on_cpu else len(observations)
    scans: list[FaceScan] = []
    for begin in range(0, len(observations), at_once):
        some = slice(begin, begin + at_once)
        if before is None:
            problems = [_SunProblem.of(one, sphere) for one in observations[some]]
            scans += [explained.scan() for explained in _explain(problems, None)]
            continue
        rows = [scan.rows(likeliest) for scan in before[some]]
        problems = [
            _SunProblem.of(one, sphere, which)
            for one, which in zip(observations[some], rows, strict=True)
        ]
        starts = [scan.solution[which] for scan, which in zip(before[some], rows, strict=True)]
        found = _explain(problems, starts)
        for scan, which, explained in zip(before[some], rows, found, strict=True):
            scans.append(explained.scan().onto(scan, which))
    return scans


@dataclass(frozen=True, kw_only=True)
class _SunProblem:
    """min_{x >= 0} |y - sum_g suns[d, g] x_g - ambient x|^2 for each direction d of a face.

    The last two of the n directions are no sun, and a lamp at the camera instead of one (or no sun
    again, where an observation has no such lamp). All is scaled by ``root``, of the weights; the
    suns and the ambient light have unit norm, from their ``norms``.
    """

    suns: Float[Tensor, "n g m"]
    ambient: Float[Tensor, "m j"]
    norms: Float[Tensor, "n k"]
    y: Float[Tensor, " m"]
    root: Float[Tensor, " m"]
    clipped: Bool[Tensor, " m"]
    normals: "_NormalErrors | None"

    @staticmethod
    def of(
        observation: Observation, sphere: bool, rows: Int[Tensor, " j"] | None = None
    ) -> "_SunProblem":
        """That of all directions, or of some ``rows`` of them, the last two among these."""
        root = observation.weights.double().sqrt()
        coarse = observation.on_rows(SCAN_HEIGHT)
        grid = coarse.transport.grid
        sources = torch.arange(len(grid) if sphere else len(grid) // 2, device=root.device)
        if rows is not None:
            sources = sources[rows[:-2]]
        groups = [coarse.transport]
        if coarse.specular is not None:
            groups.append(coarse.specular)
        # one problem for each direction, one without a sun, and one with the camera's lamp
        suns = root.new_zeros(len(sources) + 2, len(groups), len(root))
        for group, transport in enumerate(groups):
            suns[:-2, group] = transport.matrix[:, sources].T.contiguous() * root
            if observation.camera_lamp is not None:
                suns[-1, group] = observation.camera_lamp[:, group] * root
        clipped = torch.zeros_like(root, dtype=torch.bool)
        if observation.clipped is not None:
            clipped = observation.clipped
        lobes = _ambient_lobes(grid).to(root)
        ambient = coarse.transport.matrix.double() @ lobes * root[:, None]
        sun_norms, ambient_norms = _norms(suns.mT), _norms(ambient)
        return _SunProblem(
            suns=suns.div_(sun_norms[..., None]),
            ambient=ambient / ambient_norms,
            norms=torch.cat([sun_norms, ambient_norms.expand(len(suns), -1)], 1),
            y=luminance(observation.pixels).double() * root,
            root=root,
            clipped=clipped,
            normals=_NormalErrors.of(observation, sun_norms[:-2, 0], ambient_norms, lobes, sources),
        )

    def among(self, rows: Int[Tensor, " j"]) -> "_SunProblem":
        """That of some directions."""
        if len(rows) == len(self.norms):
            return self
        normals = self.normals
        if normals is not None:
            there = normals.directions[rows]
            normals = replace(normals, suns=normals.suns[rows], directions=there)
        return replace(self, suns=self.suns[rows], norms=self.norms[rows], normals=normals)

    @property
    def groups(self) -> int:
        """How many parts a sun has: scattered, and mirrored where that is known."""
        return self.suns.shape[1]

    @property
    def unknowns(self) -> int:
        return self.groups + self.ambient.shape[1]

    def gram(self) -> Float[Tensor, "n k k"]:
        suns, ambient, g = self.suns, self.ambient, self.groups
        gram = self.y.new_empty(len(suns), self.unknowns, self.unknowns)
        gram[:, :g, :g] = suns @ suns.mT
        gram[:, :g, g:] = suns @ ambient
        gram[:, g:, :g] = gram[:, :g, g:].mT
        gram[:, g:, g:] = ambient.T @ ambient
        return gram

    def right(self) -> Float[Tensor, "n k"]:
        ambient = (self.ambient.T @ self.y).expand(len(self.suns), -1)
        return torch.cat([self.suns @ self.y, ambient], 1)

    def with_bounds_at(
        self, x: Float[Tensor, "n k"], added: Float[Tensor, "n m"] | None = None
    ) -> Float[Tensor, "n m"]:
        """y of each direction where lower bounds are what x, and what is added to it, explains."""
        g = self.groups
        shaded = (x[:, None, :g] @ self.suns)[:, 0] + x[:, g:] @ self.ambient.T
        if added is not None:
            shaded = shaded + added
        return torch.where(self.clipped, torch.maximum(self.y, shaded), self.y)

    def bound_excess(
        self, x: Float[Tensor, "n k"]
    ) -> tuple[Float[Tensor, "n k"], Float[Tensor, " n"]]:
        """What y adds to the right side and to y^2 where it is raised to what x explains."""
        g, high = self.groups, self.clipped
        suns, ambient, bound = self.suns[..., high], self.ambient[high], self.y[high]
        shaded = (x[:, None, :g] @ suns)[:, 0] + x[:, g:] @ ambient.T
        excess = (shaded - bound).clamp(min=0)
        more = torch.cat([(suns @ excess[..., None])[..., 0], excess @ ambient], 1)
        return more, (excess * (excess + 2 * bound)).sum(1)


@dataclass(frozen=True, kw_only=True)
class _NormalErrors:
    """What turned normals add, in units of :class:`_SunProblem`.

    ``modes`` (3,k,m); ``suns`` (n,m) and ``ambient`` (3,j,m) are the light vectors of its suns
    (along ``directions``) and its ambient light; ``cost`` is that of u^2. In single precision:
    normals are not known better.
    """

    modes: Float[Tensor, "3 k m"]
    suns: Float[Tensor, "n m"]
    directions: Float[Tensor, "n 3"]
    ambient: Float[Tensor, "3 j m"]
    cost: float

    @staticmethod
    def of(
        observation: Observation,
        sun_norms: Float[Tensor, " n"],
        ambient_norms: Float[Tensor, " j"],
        lobes: Float[Tensor, "n2 j"],
        sources: Int[Tensor, " n"],
    ) -> "_NormalErrors | None":
        """Of the problem with those norms, of scattered light; None where normals are known."""
        errors = observation.normal_modes
        if errors is None:
            return None
        directions = errors.grid.directions.to(errors.visible)
        weights = observation.weights
        visible = errors.visible * weights.sqrt()[:, None]
        ambient = torch.stack([lobes.to(visible).T @ (visible * a).T for a in directions.T])
        suns = visible.new_zeros(len(sources) + 2, len(weights))
        suns[:-2] = visible[:, sources].T.contiguous() / sun_norms.to(visible)[:, None]
        level = weights @ luminance(observation.pixels)
        towards = directions.new_tensor([[0.0, 0.0, 1.0]])  # the camera
        if observation.camera_lamp is not None:
            diffuse_lamp = observation.camera_lamp[:, 0] * weights.sqrt()
            suns[-1] = weights.sqrt() / diffuse_lamp.norm().clamp(min=1e-12)
        return _NormalErrors(
            modes=errors.modes.permute(1, 2, 0).contiguous(),
            suns=suns,
            directions=torch.cat([directions[sources], towards.expand(2, -1)]),
            ambient=ambient / ambient_norms.to(visible)[:, None],
            cost=NORMAL_COST * float(level**2 / weights.sum()),
        )

    def added(self, x: Float[Tensor, "b q"], rows: slice, suns: int) -> Float[Tensor, "b k m"]:
        """<M_pk, F_p> in the light x of some directions, whose first is the diffuse sun's."""
        strength = x[:, :1] * self.suns[rows]
        total = x.new_zeros(len(x), self.modes.shape[1], len(self.modes[0, 0]))
        for axis, modes in enumerate(self.modes):
            vector = x[:, suns:] @ self.ambient[axis]
            vector = vector + strength * self.directions[rows, axis, None]
            total.addcmul_(vector[:, None], modes)
        return total

    def turned(
        self, x: Float[Tensor, "n q"], amounts: Float[Tensor, "n k 1"], rows: slice, suns: int
    ) -> Float[Tensor, "b m"]:
        """What turns by so much add in the light x."""
        return (amounts[rows].mT @ self.added(x[rows], rows, suns))[:, 0]


@dataclass(frozen=True, kw_only=True)
class _Explained:
    """Solutions: ``x`` (n,k) the suns' parts and the ambient ones, ``squared`` what is left.

    ``added`` (m,) is what turned normals add to the shading in the best direction; ``squared`` has
    their cost too.
    """

    problem: _SunProblem
    x: Float[Tensor, "n k"]
    squared: Float[Tensor, " n"]
    added: Float[Tensor, " m"] | None = None

    @property
    def best(self) -> int:
        """The direction of a sun that leaves least."""
        return int(self.squared[:-2].argmin())

    def scan(self) -> FaceScan:
        one = self.problem
        energy = float(one.y @ one.y)
        unexplained = self.squared.clamp(min=0) / energy
        return FaceScan(
            unexplained=unexplained[:-2],
            without_sun=float(unexplained[-2]),
            camera_lit=float(unexplained[-1]),
            strengths=(self.x[:, 0] * (one.suns[:, 0].sum(1) / one.y.sum()))[:-2],
            deviations=self.deviations() / one.root.clamp(min=1e-12),
            solution=self.x / one.norms,
        )

    def deviations(self) -> Float[Tensor, " m"]:
        """Seen less best explained; none where a bound is kept."""
        one, g = self.problem, self.problem.groups
        shaded = self.x[self.best, :g] @ one.suns[self.best]
        left = one.y - shaded - one.ambient @ self.x[self.best, g:]
        if self.added is not None:
            left = left - self.added
        return torch.where(one.clipped, left.clamp(min=0), left)


def _explain(
    problems: Sequence[_SunProblem], starts: Sequence[Float[Tensor, "n k"]] | None
) -> list[_Explained]:
    """The solution of each, from where each starts.

    Where ``clipped``, y is a lower bound: it is raised to what explains it and the problem is
    solved anew, :data:`BOUND_UPDATES` times, which never makes the error larger.
    """
    most = max(one.unknowns for one in problems)
    grams, rights = [one.gram() for one in problems], [one.right() for one in problems]
    # unknowns that a problem without specular reflection has not are 0 and stay 0
    missing = [most - one.unknowns for one in problems]
    gram = torch.stack([pad(a, (0, k, 0, k)) for a, k in zip(grams, missing, strict=True)])
    right = torch.stack([pad(r, (0, k)) for r, k in zip(rights, missing, strict=True)])
    level = torch.stack(
        [(one.y @ one.y).expand(len(r)) for one, r in zip(problems, rights, strict=True)]
    )
    if starts is None:  # with a sun what is ambient is about as without
        without_sun = nnls(gram[:, -2], right[:, -2])
        start = without_sun[:, None].repeat(1, right.shape[1], 1)
        start[:, :, 0] = 1
    else:
        scaled = [x * one.norms for x, one in zip(starts, problems, strict=True)]
        start = torch.stack([pad(x, (0, k)) for x, k in zip(scaled, missing, strict=True)])
    # from a scan before, those with wrong normals go on with these
    begun = [starts is not None and one.normals is not None for one in problems]
    fresh = [p for p, goes_on in enumerate(begun) if not goes_on]
    x = start.clone()
    if fresh:
        x[fresh] = _solved(gram[fresh], right[fresh], start[fresh])
    bounded = [p for p in fresh if bool(problems[p].clipped.any())]
    bounded_right, bounded_level = right.clone(), level.clone()
    # wrong normals raise their bounds by what is solved first
    known = any(problems[p].normals is None for p in bounded)
    for update in range((BOUND_UPDATES if known else 0) + 1 if bounded else 0):
        if update:
            x[bounded] = _solved(gram[bounded], bounded_right[bounded], x[bounded])
        for p in bounded:
            more, energy = problems[p].bound_excess(x[p, :, : problems[p].unknowns])
            bounded_right[p, :, : problems[p].unknowns] = rights[p] + more
            bounded_level[p] = level[p] + energy
    explained = []
    for p, one in enumerate(problems):
        mine, k = x[p, :, : one.unknowns], one.unknowns
        along = torch.einsum("nj,njk,nk->n", mine, grams[p], mine)
        squared = bounded_level[p] - 2 * (bounded_right[p, :, :k] * mine).sum(1) + along
        found = _Explained(problem=one, x=mine, squared=squared)
        explained.append(_turned(found, grams[p], 1 if begun[p] else NORMAL_ROUNDS))
    return explained


def _solved(
    gram: Float[Tensor, "p n k k"], right: Float[Tensor, "p n k"], start: Float[Tensor, "p n k"]
) -> Float[Tensor, "p n k"]:
    flat = gram.flatten(0, 1), right.flatten(0, 1)
    return nnls(*flat, start=start.flatten(0, 1)).reshape(right.shape)


def _turned(explained: _Explained, gram: Float[Tensor, "n k k"], rounds: int) -> _Explained:
    """The same with normals that may be wrong, if they may; ``gram`` is the problem's.

    With F from the x before, D = <M, F> and u = (D^T D + c I)^-1 D^T (y - X x) at its best, x is
    that of a small problem again, with X^T X less X^T D (D^T D + c I)^-1 D^T X. After the first
    round the :data:`FURTHER` best directions go on.
    """
    one, errors = explained.problem, explained.problem.normals
    if errors is None:
        return explained
    seen = one.y.to(errors.modes)
    count, bounded = len(explained.x), bool(one.clipped.any())
    block = _BLOCK if seen.device.type == "cpu" else count
    single = replace(one, suns=one.suns.to(seen), ambient=one.ambient.to(seen), y=seen)
    gram = gram.to(seen)
    x, y = explained.x.to(seen), seen.expand(count, -1)
    if bounded:
        y = single.with_bounds_at(x)
    kept = torch.arange(count, device=x.device)
    modes = errors.modes.shape[1]
    found = {"x": x.clone(), "before": torch.zeros_like(x)}
    found |= {"amounts": x.new_zeros(count, modes, 1), "squared": explained.squared.to(x)}
    if rounds > 1 and count > FURTHER + 2:
        best = found["squared"][:-2].argsort()[:FURTHER].sort().values
        kept = torch.cat([best, best.new_tensor([count - 2, count - 1])])
        single, gram, x, y = single.among(kept), gram[kept], x[kept], y[kept]
    for further in reversed(range(rounds)):
        rows = [slice(begin, begin + block) for begin in range(0, len(x), block)]
        parts = [_without_turns(single, gram[some], x[some], y[some], some) for some in rows]
        small, right, level, solved = (torch.cat(part) for part in zip(*parts, strict=True))
        before, x = x, nnls(small, right, start=x)
        amounts = solved[:, :, -1:] - solved[:, :, :-1] @ x[:, :, None]
        along = (x[:, None] @ small @ x[:, :, None])[:, 0, 0]
        found["x"][kept], found["before"][kept], found["amounts"][kept] = x, before, amounts
        found["squared"][kept] = level - 2 * (right * x).sum(1) + along
        if bounded and further:
            assert single.normals is not None
            turned = [single.normals.turned(before, amounts, some, one.groups) for some in rows]
            y = single.with_bounds_at(x, torch.cat(turned))
    end = _Explained(problem=one, x=found["x"].to(one.y), squared=found["squared"].to(one.y))
    at = slice(end.best, end.best + 1)
    added = errors.turned(found["before"], found["amounts"], at, one.groups)
    return replace(end, added=added[0].to(one.y))


def _without_turns(
    one: _SunProblem,
    gram: Float[Tensor, "b k k"],
    x: Float[Tensor, "b k"],
    y: Float[Tensor, "b m"],
    rows: slice,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The problem of some ``rows`` without u, which is at its best: X^T X, X^T y, y^T y, and what
    tells that u."""
    assert one.normals is not None
    suns, turned = one.suns[rows], one.normals.added(x, rows, one.groups)
    inner = turned @ turned.mT
    inner = inner + one.normals.cost * torch.eye(inner.shape[1]).to(inner)
    own = turned @ torch.cat([suns, y[:, None]], 1).mT
    across = torch.cat([own[:, :, :-1], turned @ one.ambient, own[:, :, -1:]], 2)
    solved = torch.linalg.solve(inner, across)
    less = across.mT @ solved
    right = torch.cat([(suns @ y[:, :, None])[:, :, 0], y @ one.ambient], 1)
    level = y.square().sum(1) - less[:, -1, -1]
    return gram - less[:, :-1, :-1], right - less[:, :-1, -1], level, solved


def _norms(columns: Float[Tensor, "*g m n"]) -> Float[Tensor, "*g n"]:
    """Over which columns have about the same scale."""
    return columns.norm(dim=-2).clamp(min=1e-12)


def _ambient_lobes(grid: DirectionGrid) -> Float[Tensor, "n k"]:
    """Broad non-negative lobes, ((1 + cos) / 2)^3 round Hammersley directions: 75 degrees wide."""
    centres = DirectionGrid.hammersley(LOBES).directions
    return ((1 + grid.directions @ centres.T) / 2) ** 3


def best_apart(
    directions: Float[Tensor, "n 3"],
    values: Float[Tensor, " n"],
    count: int,
    separation: float,
    before: Sequence[int] = (),
) -> list[int]:
    """``before`` and then the smallest finite values, ``count`` in all.

    Each is at least ``separation`` (radians) from those before it.
    """
    chosen = list(before)
    for i in values.argsort()[: int(values.isfinite().sum())].tolist():
        if all(float(directions[i] @ directions[j]) < math.cos(separation) for j in chosen):
            chosen.append(i)
        if len(chosen) == count:
            break
    return chosen
