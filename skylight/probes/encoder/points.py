"""Selection of the points of a known object that determine the light best."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.encoder.basis import SurfaceTransfer
from skylight.probes.partitions.relight.receivers import Receivers
from skylight.probes.partitions.relight.scene import Scene

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
