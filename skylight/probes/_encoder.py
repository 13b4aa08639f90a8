"""A known object as an encoder of light: the dual of its points' basis (thesis, 4.4.4 and 7.1.1).

A Lambertian point p of an object whose shape and colour are known turns light into the radiance
``s_p = int b_p(w) L(w) dw`` with ``b_p(w) = rho_p / pi V_p(w) <n_p, w>+`` plus the interreflection
from other parts of the object, so every point measures the light against a function of its own
(thesis, Eq. 4.18 and section 7.1.1). :func:`surface_transfer` traces these functions,
:func:`choose_points` selects the points that determine the light best, and
:class:`ObjectEncoder` tells the light from what they show, or lights other objects with it.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight._modes import on_cpu
from skylight._module import Module
from skylight.errors import InputError, check_shape
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.relight._atlas import Receivers
from skylight.probes.partitions.relight._gather import Gatherer, Nodes, gather_all
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import TransferCoefficients
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import diffuse_transport

_STRATA = "38d"  # cells that the rays of bounces are weighed in


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceTransfer:
    """``functions`` (m,d,3), 1/sr: b_p(w) of m points and the d directions of ``grid``, in Rec.709.

    Shading is ``sum_w dw b_p(w) L(w)``.
    """

    functions: Float[Tensor, "m d 3"]
    grid: DirectionGrid

    def __post_init__(self) -> None:
        if self.functions.shape[1] != len(self.grid):
            raise ValueError(
                f"functions {tuple(self.functions.shape)} must have a value for each of the "
                f"{len(self.grid)} directions"
            )
        if not bool(self.functions.isfinite().all()):
            raise InputError("the points' transfer has values that are NaN or infinite")

    def __len__(self) -> int:
        return len(self.functions)

    def at(self, points: Int[Tensor, " k"]) -> "SurfaceTransfer":
        """That of some of the points."""
        return SurfaceTransfer(functions=self.functions[points], grid=self.grid)

    def weighted(self) -> Float[Tensor, "3 m d"]:
        """``sqrt(dw) b_p(w)`` for each colour, float64: dot products of rows are integrals."""
        root = self.grid.solid_angles.sqrt()
        return self.functions.double().permute(2, 0, 1) * root

    def shading(self, radiance: Float[Tensor, "b d 3"]) -> Float[Tensor, "b m 3"]:
        """What the points show under lights on the grid."""
        power = radiance.double() * self.grid.solid_angles[:, None]
        return torch.einsum("mdc,bdc->bmc", self.functions.double(), power).to(radiance)


def surface_transfer(
    scene: Scene,
    receivers: Receivers,
    grid: DirectionGrid,
    *,
    bounces: int = 0,
    rays: int = 512,
    seed: int = 0,
    workers: int = 1,
) -> SurfaceTransfer:
    """b_p over the grid at points of a scene: one shadow ray per direction, then the bounces.

    Light bounces between the scene's vertices and is interpolated in between; ``rays`` leave each
    vertex and point to find where it comes from
    (:mod:`skylight.probes.partitions.relight._gather`).
    ``seed`` is theirs. More than one of ``workers``, processes, needs ``fork``.

    Memory: 12 d bytes for each point, three times that for each vertex where light bounces:
    200 MB for 2,048 directions and 3,000 vertices, so decimate scanned objects.
    """
    if bounces < 0:
        raise InputError(f"bounces must be 0 or more, got {bounces}")
    functions = _direct(scene, receivers, grid, workers)
    if bounces:
        nodes, cells = Nodes.of(scene), Cells.of(named_design(_STRATA))
        generator = torch.Generator().manual_seed(seed)

        def gathered_at(points: Receivers):
            gatherer = Gatherer(points, scene, nodes, cells, rays=rays, generator=generator)
            return gather_all(gatherer, workers=workers)

        def passed_on(gathered, light: Tensor, points: Receivers) -> Tensor:
            arriving = torch.from_numpy(gathered.from_nodes(light.flatten(1).numpy()))
            return arriving.reshape(-1, *light.shape[1:]) * points.albedo.float()[:, None]

        direct = _direct(scene, nodes.receivers, grid, workers)
        total, between = direct, gathered_at(nodes.receivers)
        for _ in range(bounces - 1):
            total = direct + passed_on(between, total, nodes.receivers)
        functions = functions + passed_on(gathered_at(receivers), total, receivers)
    return SurfaceTransfer(functions=functions, grid=grid)


def _direct(
    scene: Scene, receivers: Receivers, grid: DirectionGrid, workers: int
) -> Float[Tensor, "m d 3"]:
    """rho / pi V <n, w>+, float32."""
    transport = diffuse_transport(
        receivers.positions,
        receivers.normals,
        receivers.geometric_normals,
        scene.raycaster,
        grid,
        workers=workers,
    )
    per_angle = transport.matrix / grid.solid_angles.float()
    return per_angle[:, :, None] * receivers.albedo.float()[:, None]


DEPENDENT = 1e-5  # of the largest: functions that add less are rounding errors of the transfer
_SWEEPS = 20
_LEAST_GAIN = 1e-3  # of a sweep, of what is made small


def surface_points(scene: Scene, count: int, generator: torch.Generator) -> Receivers:
    """Points drawn evenly by area."""
    if count < 1:
        raise InputError(f"at least one point is needed, got {count}")
    a, b, c = scene.vertices[scene.faces].unbind(1)
    area = torch.linalg.cross(b - a, c - a).norm(dim=1)
    # torch.multinomial takes no more than 2^24 triangles, and this any number
    drawn = torch.rand(count, generator=generator, dtype=torch.float64) * area.sum()
    face = torch.searchsorted(area.cumsum(0), drawn).clamp(max=len(area) - 1)
    u, v = torch.rand(2, count, generator=generator, dtype=torch.float64)
    u = u.sqrt()
    barycentric = torch.stack([1 - u, u * (1 - v), u * v], dim=1)
    return Receivers.on_surface(scene, face, barycentric)


def choose_points(
    candidates: SurfaceTransfer,
    count: int,
    *,
    noise: float = 0.0,
    lit: SurfaceTransfer | None = None,
) -> Int[Tensor, " k"]:
    """``count`` of the candidates, by the conditioning of the light or by relighting error.

    First those whose functions stand out most from all before them: the pivots of a QR
    decomposition of ``sqrt(dw) b_p(w)`` (Businger and Golub 1965). Then each point in turn is
    exchanged for the best of all candidates, until a sweep gains less than 0.1 %. With G the Gram
    matrix of the chosen functions and ``r = noise^2 mean |b_p|^2`` over the candidates (noise:
    standard deviation relative to the shading's root mean square), best is

    without ``lit``
        the least ``tr (G + r)^-1``: functions as orthogonal, and as strong, as can be. Without
        noise it is the mean squared error that errors of the shading put into the light.
    with ``lit``
        the least mean squared error of what its points x show by the shading of the chosen, for
        lights that are white noise on the sphere (Cohn 1996):
        ``sum_x <T_x, T_x> - <T_x, b> (G + r)^-1 <b, T_x>``. Give the candidates themselves where
        it is not known what will be lit: that relights other objects better than conditioning.

    Functions are means over the three colours.
    """
    if count < 1:
        raise InputError(f"an encoder needs one point or more, got {count}")
    if count > len(candidates):
        raise InputError(f"{count} points cannot be chosen from {len(candidates)}: give more")
    rows = candidates.weighted().mean(0)
    first = _pivots(rows, count)
    if len(first) < count:
        raise InputError(
            f"the candidates tell only {len(first)} lights apart: choose at most as many points"
        )
    gram = rows @ rows.T
    gram.diagonal().add_(noise**2 * gram.diagonal().mean())
    if lit is None:
        return _exchanged(gram, -torch.eye(len(rows), dtype=rows.dtype), 0.0, first)
    if not torch.equal(lit.grid.directions, candidates.grid.directions):
        raise InputError("the candidates and what they light need one and the same grid")
    shown = lit.weighted().mean(0)
    across = shown @ rows.T
    return _exchanged(gram, across.T @ across, float(shown.square().sum()), first)


def _pivots(rows: Float[Tensor, "m d"], count: int) -> Int[Tensor, " _"]:
    """The rows of largest remainders beyond those before, less than ``count`` if no more is left.

    The pivots of a QR decomposition of the rows' transpose, by modified Gram-Schmidt.
    """
    rest, chosen = rows.clone(), []
    least = DEPENDENT * float(rows.norm(dim=1).max())
    for _ in range(count):
        lengths = rest.norm(dim=1)
        longest = int(lengths.argmax())
        if not float(lengths[longest]) > least:
            break
        unit = rest[longest] / lengths[longest]
        rest -= (rest @ unit)[:, None] * unit
        chosen.append(longest)
    return torch.tensor(chosen)


def _exchanged(
    gram: Float[Tensor, "m m"],
    worth: Float[Tensor, "m m"],
    most: float,
    chosen: Int[Tensor, " k"],
) -> Int[Tensor, " k"]:
    """Points swapped one by one, each for the candidate with the least ``most - tr G^-1 Q``.

    G and Q are the rows and columns of ``gram`` and ``worth`` that belong to the points. Beside
    others with G^-1 = R, a candidate with the columns g and q, and a = R g, adds
    ``(q_cc - 2 <a, q> + <a, Q a>) / (g_cc - <g, a>)`` to the trace: a bordered matrix's inverse.
    """
    chosen = chosen.clone()
    least = DEPENDENT**2 * float(gram.diagonal().max())
    cost = most - _trace(gram, worth, chosen)
    for _ in range(_SWEEPS):
        for i in range(len(chosen)):
            others = torch.cat([chosen[:i], chosen[i + 1 :]])
            square = (others[:, None], others)
            solved = gram[:, others] @ torch.linalg.inv(gram[square])
            rest = gram.diagonal() - (solved * gram[:, others]).sum(1)
            added = worth.diagonal() - 2 * (solved * worth[:, others]).sum(1)
            added = (added + ((solved @ worth[square]) * solved).sum(1)) / rest
            added[others] = -torch.inf
            added[rest <= least] = -torch.inf
            if bool(added.isfinite().any()):
                chosen[i] = added.argmax()
        before, cost = cost, most - _trace(gram, worth, chosen)
        if before - cost <= _LEAST_GAIN * before:
            break
    return chosen


def _trace(
    gram: Float[Tensor, "m m"], worth: Float[Tensor, "m m"], chosen: Int[Tensor, " k"]
) -> float:
    square = (chosen[:, None], chosen)
    return float(torch.linalg.solve(gram[square], worth[square]).trace())


class ObjectEncoder(Module):
    """Shading of k points as coefficients of the light in the dual of the points' basis.

    ``encoder(radiance)`` is the shading, :meth:`decode` the light that it tells of. The functions
    b_i of an object's points are not orthogonal. Their dual is ``b* = (G + r)^-1 b`` with the Gram
    matrix ``G_ij = int b_i b_j dw``. Without ridge r it is bi-orthogonal,
    ``int b_i b*_j dw = delta_ij`` (Eq. 4.21), and ``L = sum_i s_i b*_i`` is, of all lights that
    show the shading s, the one of least ``int L^2 dw``. A probe whose functions do not overlap has
    a diagonal G and Eq. 4.22 for its dual.

    The ridge follows from the noise: ``r = noise^2 mean_i G_ii`` makes L the best linear estimate
    for lights that are white noise on the sphere, where errors of the shading are independent
    with a standard deviation of ``noise`` times its root mean square (Wiener filter; Tarantola
    2005, 3.2).

    ``basis`` (3,k,d) is an ``nn.Parameter``, which photographs under known light can calibrate;
    the dual is solved for whenever it is asked for.
    """

    basis: nn.Parameter
    solid_angles: Tensor

    @on_cpu
    def __init__(self, points: SurfaceTransfer, *, noise: float = 0.0) -> None:
        super().__init__()
        if not noise >= 0:
            raise InputError(f"the noise must be 0 or more, got {noise:g}")
        self.grid, self.noise = points.grid, noise
        rows = points.weighted()
        values = torch.linalg.svdvals(rows)
        if values.shape[1] < len(points) or bool((values[:, 0] == 0).any()):
            raise InputError(
                f"{len(points)} points on a grid of {len(self.grid)} directions, or points that no "
                "light reaches: choose others or a finer grid"
            )
        if noise == 0 and bool((values[:, -1] < DEPENDENT * values[:, 0]).any()):
            raise InputError(
                "some points show the same as others together: choose fewer or give the noise"
            )
        self.basis = nn.Parameter(rows / self.grid.solid_angles.sqrt())
        self.register_buffer("solid_angles", self.grid.solid_angles, persistent=False)

    @property
    def gram(self) -> Float[Tensor, "3 k k"]:
        """G_ij = int b_i b_j dw for each colour."""
        return (self.basis * self.solid_angles) @ self.basis.mT

    @property
    def ridge(self) -> Float[Tensor, "3"]:
        """r for each colour."""
        return self.noise**2 * self._rows.square().sum(-1).mean(-1)

    @property
    def dual(self) -> Float[Tensor, "3 k d"]:
        """b*_i for each colour.

        ``R^-1 Q_1^T`` with ``[B^T; sqrt(r) I] = [Q_1; Q_2] R`` of the rows B, ``sqrt(dw) b``: the
        Gram matrix, whose condition is that of B squared, is never formed.
        """
        rows = self._rows
        identity = torch.eye(rows.shape[1], dtype=rows.dtype, device=rows.device)
        ridge = self.ridge.sqrt()[:, None, None] * identity
        orthogonal, triangle = torch.linalg.qr(torch.cat([rows.mT, ridge], dim=1))
        mine = orthogonal[:, : rows.shape[2]].mT
        return torch.linalg.solve_triangular(triangle, mine, upper=True) / self.solid_angles.sqrt()

    @property
    def _rows(self) -> Float[Tensor, "3 k d"]:
        return self.basis * self.solid_angles.sqrt()

    def forward(self, radiance: Float[Tensor, "*b d 3"]) -> Float[Tensor, "*b k 3"]:
        """``sum_w b_k(w) L(w) dw``: what the k points show, ``(..., k, 3)``, in L's units.

        Of radiance ``(..., d, 3)`` on the encoder's grid; linear, differentiable.
        """
        check_shape("ObjectEncoder's radiance", radiance.shape, len(self.grid), 3)
        power = radiance.to(self.basis.dtype) * self.solid_angles[:, None]
        return torch.einsum("ckd,...dc->...kc", self.basis, power).to(radiance.dtype)

    def encode_map(self, environment: EnvironmentMap) -> Float[Tensor, "k 3"]:
        """What the points show under a map, which is averaged to the encoder's grid."""
        if self.grid.layout is None or environment.is_sky:
            raise InputError("a map needs an encoder on a lat-long grid, and the whole sphere")
        return self(environment.resize(self.grid.layout[0]).flat.to(self.solid_angles.device))

    def decode(self, shading: Float[Tensor, "*b k 3"]) -> Float[Tensor, "*b d 3"]:
        """The light ``sum_i s_i b*_i`` on the grid; it may be negative in places."""
        check_shape("ObjectEncoder's shading", shading.shape, self.basis.shape[1], 3)
        light = torch.einsum("...kc,ckd->...dc", shading.to(self.basis.dtype), self.dual)
        return light.to(shading.dtype)

    @torch.no_grad()
    def transfer(self, receivers: SurfaceTransfer) -> TransferCoefficients:
        """``t_i(x) = int T_x(w) b*_i(w) dw``: points x then show ``sum_i s_i t_i(x)``.

        With :class:`skylight.probes.partitions.relight._composite.Relighting` the captured shading
        lights them, as that of a partition probe does. All bounces count as one order, under a
        light of 1.
        """
        if not torch.equal(receivers.grid.directions, self.grid.directions):
            raise InputError("the encoder and what it lights need one and the same grid")
        weighted = self.dual * self.solid_angles
        values = torch.einsum("mdc,ckd->mkc", receivers.functions.to(weighted), weighted)
        white = self(torch.ones(1, len(self.grid), 3).to(self.basis))
        return TransferCoefficients(
            values=values.float(), orders=(values * white).sum(1).mean()[None].float()
        )
