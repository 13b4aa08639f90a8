"""Transfer of voxel faces with interreflection, and the reconstruction of missing slots by it.

The simplest geometry that gives a face its configuration, Lambertian of one albedo, is lit by each
spherical harmonic (thesis, section 3.4.4, Eq. 3.15 to 3.17): radiosity in the cell in front of the
face, on the six sides of a unit cube.

Light that leaves the cell through an open side meets none of the neighbours again (each of them
lies beyond a side of its own), so that the cell is all there is to the transport of the simplest
geometry of a configuration. Direct light of every harmonic is integrated over the open sides;
interreflections are solved for by collocation, radiance being a polynomial on each side (Cohen and
Wallace 1993, chapter 3).

The cell is [0, 1]^3 in the frame of the face: x right, y forward, z along its normal. Side 0 is the
face itself, side i + 1 is where occluder i of :data:`~skylight.probes.voxel._model.OCCLUDERS` is.
"""

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight._modes import constant
from skylight.errors import InputError
from skylight.probes.voxel._model import CONFIGURATIONS, FORWARD, NORMALS, ORIENTATIONS, RIGHT
from skylight.probes.voxel._reconstruct import SlotReconstruction, combinations_of
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._rotation import rotate

TERMS = 10  # of the polynomial, along each axis
_NODES = 12  # Gauss-Legendre, on each side of a point's foot

# a corner of each side, its two edges (their cross product points into the cell)
_SIDES = torch.tensor(
    [
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 0], [0, 1, 0], [0, 0, 1]],  # left
        [[1, 0, 0], [0, 0, 1], [0, 1, 0]],  # right
        [[0, 1, 0], [1, 0, 0], [0, 0, 1]],  # forward
        [[0, 0, 0], [0, 0, 1], [1, 0, 0]],  # backward
        [[0, 0, 1], [0, 1, 0], [1, 0, 0]],  # top
    ],
    dtype=torch.float64,
)
_INWARD = torch.linalg.cross(_SIDES[:, 1], _SIDES[:, 2])


class CellTransfer:
    """Outgoing radiance at points (right, forward) in [0, 1]^2 of the face where the light is Y_i.

    ``L = albedo (E / pi + F L)`` for each configuration, light and harmonics in the face's frame.
    What depends on the points alone is integrated once, for any number of albedos.
    """

    def __init__(self, points: Float[Tensor, "m 2"], degree: int) -> None:
        here = torch.nn.functional.pad(points.double(), (0, 1))
        self._received = {s: _received(here, 0, s, degree) for s in range(1, len(_SIDES))}
        self._direct, self._factors = _between_sides(degree)

    def at(self, albedo: float | Float[Tensor, ""]) -> Float[Tensor, "32 m k"]:
        """Differentiable in the albedo. A cell that is closed all round is dark."""
        return albedo * torch.stack([self._arriving(c, albedo) for c in range(CONFIGURATIONS)])

    def _arriving(self, configuration: int, albedo: float | Tensor) -> Float[Tensor, "m k"]:
        closed = [s for s in self._received if configuration >> (s - 1) & 1]
        free = [s for s in self._received if s not in closed]
        if not free:
            return torch.zeros_like(self._received[1][0])
        total = torch.stack([self._received[s][0] for s in free]).sum(0)
        radiance = _solved(self._direct, self._factors, [0, *closed], free, albedo)
        for side in closed:  # a plane does not light itself
            total = total + self._received[side][1] @ radiance[side]
        return total


def _solved(
    direct: Float[Tensor, "6 6 p k"],
    factors: Float[Tensor, "6 p 6 p"],
    closed: list[int],
    free: list[int],
    albedo: float | Tensor,
) -> dict[int, Float[Tensor, "p k"]]:
    """Radiance at the nodes of each closed side."""
    emitted = direct[free][:, closed].sum(0).flatten(0, 1)
    kernel = factors[closed][:, :, closed].flatten(2).flatten(0, 1)
    system = torch.eye(len(kernel), dtype=torch.float64) - albedo * kernel
    radiance = torch.linalg.solve(system, albedo * emitted)
    return dict(zip(closed, radiance.split(direct.shape[2]), strict=True))


@constant()
def _between_sides(degree: int) -> tuple[Float[Tensor, "6 6 p k"], Float[Tensor, "6 p 6 p"]]:
    """(light through side t to the nodes of side s: [t, s], what they see of each other [s, t])."""
    ticks = torch.from_numpy((np.polynomial.legendre.leggauss(TERMS)[0] + 1) / 2)
    u, v = torch.meshgrid(ticks, ticks, indexing="ij")
    sides, nodes = len(_SIDES), TERMS**2
    direct = torch.zeros(sides, sides, nodes, (degree + 1) ** 2, dtype=torch.float64)
    factors = torch.zeros(sides, nodes, sides, nodes, dtype=torch.float64)
    for s, (corner, first, second) in enumerate(_SIDES):
        points = corner + u.reshape(-1, 1) * first + v.reshape(-1, 1) * second
        for t in range(sides):
            if t != s:
                direct[t, s], factors[s, :, t] = _received(points, s, t, degree)
    return direct, factors


def _received(
    points: Float[Tensor, "m 3"], side: int, other: int, degree: int
) -> tuple[Float[Tensor, "m k"], Float[Tensor, "m p"]]:
    """``1 / pi int f <n, w> dw`` over the directions from points of a side to another side.

    For f each harmonic of w, and for f each polynomial of the place there that is 1 at one node
    and 0 at the others. With a the distance to the other side's plane and (s, t) the foot in it,
    ``u = s + a sinh p`` and ``v = t + a sinh q`` take the kernel's peak away: Gauss-Legendre rules
    in p and q on both sides of the foot converge exponentially.
    """
    corner, first, second = _SIDES[other]
    offset = points - corner
    distance = offset @ _INWARD[other]
    u, u_weight = _sinh_rule(offset @ first, distance)
    v, v_weight = _sinh_rule(offset @ second, distance)
    place = corner + u[:, :, None, None] * first + v[:, None, :, None] * second
    towards = place - points[:, None, None]
    length = towards.norm(dim=-1)
    cosine = (towards @ _INWARD[side]) / length
    weight = u_weight[:, :, None] * v_weight[:, None, :] * cosine / length**3
    weight = weight * distance[:, None, None] / math.pi
    basis = harmonics.evaluate((towards / length[..., None]).reshape(-1, 3), degree)
    basis = basis.reshape(len(points), -1, basis.shape[1])
    light = (weight.flatten(1)[:, None] @ basis)[:, 0]
    seen = _lagrange(u).mT @ weight @ _lagrange(v)
    return light, seen.flatten(1)


def _sinh_rule(
    foot: Float[Tensor, " m"], scale: Float[Tensor, " m"]
) -> tuple[Float[Tensor, "m q"], Float[Tensor, "m q"]]:
    """Nodes in [0, 1] and weights of a rule that is fine near the foot."""
    nodes, weights = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(_NODES))
    places, shares = [], []
    for end in (0.0, 1.0):
        reach = torch.asinh((end - foot) / scale)
        p = reach[:, None] * (nodes + 1) / 2
        places.append(foot[:, None] + scale[:, None] * torch.sinh(p))
        shares.append(reach.abs()[:, None] / 2 * weights * scale[:, None] * torch.cosh(p))
    return torch.cat(places, 1), torch.cat(shares, 1)


def _lagrange(places: Float[Tensor, "m q"]) -> Float[Tensor, "m q p"]:
    """The polynomials in [0, 1] that are 1 at one Gauss-Legendre node and 0 at the others."""
    nodes, _ = np.polynomial.legendre.leggauss(TERMS)
    values = np.polynomial.legendre.legvander(2 * places.numpy() - 1, TERMS - 1)
    to_nodes = np.linalg.inv(np.polynomial.legendre.legvander(nodes, TERMS - 1))
    return torch.from_numpy(values @ to_nodes)


DEGREE = 4  # 25 harmonics
SIZE = 16


def transfer_vectors(
    albedo: float, *, size: int = SIZE, degree: int = DEGREE
) -> Float[Tensor, "6 32 n n k"]:
    """t of each texel centre of each slot, float64: radiance is ``t @ coefficients of the light``.

    Light is in the world's harmonics. Orientations differ by rotations of the basis alone, which
    are exact. Error: see :func:`slot_transfer`.
    """
    local = slot_transfer(albedo, size=size, degree=degree)
    # what a face receives of Y_i(R^T w) is what the world's light Y_i sends after D(R)
    return torch.stack([rotate(local, face_frame(o)) for o in range(len(ORIENTATIONS))])


def slot_transfer(
    albedo: float | Float[Tensor, ""], *, size: int = SIZE, degree: int = DEGREE
) -> Float[Tensor, "32 n n k"]:
    """:func:`transfer_vectors` for harmonics of the face's frame (right, forward, normal).

    Relative error of a slot's vector against 16 x 16 polynomials: 3e-4 at most for an albedo of
    1, less for darker ones. It takes a second or two, and is cached but where the albedo needs a
    gradient.
    """
    if not 0 <= albedo <= 1:
        raise InputError(f"an albedo lies in 0 to 1, got {float(albedo):g}")
    if size < 1 or degree < 0:
        raise InputError(f"size must be 1 or more and degree 0 or more, got {size} and {degree}")
    if isinstance(albedo, Tensor) and albedo.requires_grad and torch.is_grad_enabled():
        return _cell_transfer(size, degree).at(albedo).unflatten(1, (size, size))
    return _cached_transfer(float(albedo), size, degree).clone()


@torch.library.custom_op("skylight::slot_transfer", mutates_args=())
def solved_transfer(albedo: Tensor, size: int, degree: int) -> Tensor:
    """:func:`slot_transfer` of (c,) albedos for graphs, which call it as it is: (c,32,n,n,k)."""
    found = [slot_transfer(a, size=size, degree=degree) for a in albedo.detach().tolist()]
    return torch.stack(found).to(albedo.device)


@torch.library.custom_op("skylight::slot_transfer_backward", mutates_args=())
def _transfer_slope(grad: Tensor, albedo: Tensor, size: int, degree: int) -> Tensor:
    """``<grad, d t / d albedo>`` of each."""
    slopes = torch.stack([_cached_slope(a, size, degree) for a in albedo.tolist()]).to(grad)
    return (grad * slopes).flatten(1).sum(1).to(albedo)


def _transfer_shaped(albedo: Tensor, size: int, degree: int) -> Tensor:
    shape = len(albedo), CONFIGURATIONS, size, size, (degree + 1) ** 2
    return albedo.new_empty(shape, dtype=torch.float64)


def _slope_shaped(grad: Tensor, albedo: Tensor, size: int, degree: int) -> Tensor:
    return torch.empty_like(albedo)


def _keep_albedo(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    albedo, *ctx.rule = inputs
    ctx.save_for_backward(albedo)


def _transfer_backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
    return _transfer_slope(grad, *ctx.saved_tensors, *ctx.rule), None, None


solved_transfer.register_fake(_transfer_shaped)
_transfer_slope.register_fake(_slope_shaped)
solved_transfer.register_autograd(_transfer_backward, setup_context=_keep_albedo)


@constant(8)
def _cached_transfer(albedo: float, size: int, degree: int) -> Tensor:
    return _cell_transfer(size, degree).at(albedo).unflatten(1, (size, size))


@constant(8)
def _cached_slope(albedo: float, size: int, degree: int) -> Tensor:
    """d t / d albedo."""
    at, transfer = torch.tensor(albedo, dtype=torch.float64), _cell_transfer(size, degree)
    return torch.func.jvp(transfer.at, (at,), (torch.ones_like(at),))[1].unflatten(1, (size, size))


@constant(4)
def _cell_transfer(size: int, degree: int) -> CellTransfer:
    along = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    # row 0 lies forward, column 0 left
    forward, right = torch.meshgrid(along.flip(0), along, indexing="ij")
    return CellTransfer(torch.stack([right, forward], -1).reshape(-1, 2), degree)


def face_frame(orientation: int) -> Float[Tensor, "3 3"]:
    """Columns: where right, forward and the normal of a face point in the world."""
    axes = np.stack([RIGHT[orientation], FORWARD[orientation], NORMALS[orientation]], 1)
    return torch.from_numpy(axes).double()


# Of the thesis' figures: with 0.8, the renderer's default, its errors come out to 5 %.
ALBEDO = 0.8
COST = 0.16  # at an albedo of 1


class GlobalReconstruction(SlotReconstruction):
    """From transfer vectors: ``argmin |tau_u - T^T x|^2 + cost |x|_0``.

    tau stacks the 16 x 16 texels' 25 coefficients of outgoing radiance, divided by the albedo so
    that a slot costs as much in dark material as in bright: ``|tau|^2`` of a free face is 54. With
    an albedo of 0.8, a cost of 1.6, which is the thesis' 1 for radiance, gives errors larger than
    the thesis prints (5-probe: 0.0114 +- 0.0164); costs of 0.16 and less give those it prints.
    """

    def __init__(
        self, known: Bool[Tensor, "6 32"], *, albedo: float = ALBEDO, cost: float = COST
    ) -> None:
        if not cost >= 0:
            raise InputError(f"the cost of a slot must be 0 or more, got {cost}")
        if not 0 < albedo <= 1:
            raise InputError(f"the probe's albedo must be above 0 and at most 1, got {albedo:g}")
        # inner products are all that counts, and the orientations' rotations keep them
        rows = slot_transfer(albedo).flatten(1) / albedo
        rows = rows[None].expand(len(ORIENTATIONS), -1, -1)
        super().__init__(combinations_of(rows, known, cost=cost), known)
