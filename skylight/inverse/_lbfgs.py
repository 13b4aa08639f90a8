"""L-BFGS for many independent small problems at once, sharing each evaluation as one batch."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

# f(x (b,p), index (b,)) -> losses (b,): row i belongs to problem index[i]
Objective = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """The best iterate of each problem, never one with a non-finite loss.

    ``converged``: the last accepted step changed the loss by less than the tolerance, or no
    descent was possible any more. ``evaluations`` are the trial points of each problem,
    ``nonfinite`` those whose loss or gradient was not finite and which were rejected.
    """

    x: Float[Tensor, "b p"]
    loss: Float[Tensor, " b"]
    converged: Bool[Tensor, " b"]
    iterations: Int[Tensor, " b"]
    evaluations: Int[Tensor, " b"]
    nonfinite: Int[Tensor, " b"]


@torch.no_grad()
def minimise(
    objective: Objective,
    x0: Float[Tensor, "b p"],
    *,
    iterations: int,
    memory: int = 10,
    tolerance: float = 1e-5,
    first_step: float = 0.1,
) -> Minimum:
    """Quasi-Newton descent by the two-loop recursion (Nocedal & Wright 2006, algorithm 7.4).

    Steps are halved until they satisfy Armijo's condition (c = 1e-4), per problem; pairs with
    s.y <= 0 are not remembered. Problems that stopped are not evaluated any more. A problem
    whose start is not finite keeps its start, a loss of infinity and ``converged`` False.

    ``tolerance`` is relative to the loss; ``first_step`` is the length of the first step.
    """
    count = len(x0)
    x = x0.clone()
    everyone = torch.arange(count, device=x.device)
    evaluations, nonfinite = torch.zeros_like(everyone), torch.zeros_like(everyone)

    def evaluate(points: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            leaf = points.detach().requires_grad_(True)
            loss = objective(leaf, index)
            (slope,) = torch.autograd.grad(loss.sum(), leaf)
        bad = ~(loss.isfinite() & slope.isfinite().all(1))
        evaluations[index] += 1
        nonfinite[index] += bad
        return (
            torch.where(bad, torch.inf, loss.detach()),
            torch.where(bad[:, None], 0.0, slope),
        )

    loss, slope = evaluate(x, everyone)
    steps: list[Tensor] = []
    turns: list[Tensor] = []
    active = loss.isfinite()
    converged = torch.zeros_like(active)
    used = torch.zeros_like(everyone)
    for _ in range(iterations):
        index = torch.nonzero(active)[:, 0]
        if len(index) == 0:
            break
        direction = -_two_loop(slope[index], [s[index] for s in steps], [y[index] for y in turns])
        descent = (direction * slope[index]).sum(1)
        # fall back to the gradient where the model of the curvature points uphill
        uphill = descent >= 0
        direction = torch.where(uphill[:, None], -slope[index], direction)
        descent = torch.where(uphill, -(slope[index] ** 2).sum(1), descent)
        length = direction.norm(dim=1)
        scale = torch.ones_like(length) if steps else first_step / length
        scale = torch.where(uphill, first_step / length.clamp(min=1e-30), scale)
        new_x, new_loss, new_slope = x[index].clone(), loss[index].clone(), slope[index].clone()
        accepted = torch.zeros_like(uphill)
        for _ in range(20):
            todo = torch.nonzero(~accepted)[:, 0]
            if len(todo) == 0:
                break
            trial = x[index[todo]] + scale[todo, None] * direction[todo]
            trial_loss, trial_slope = evaluate(trial, index[todo])
            enough = trial_loss <= loss[index[todo]] + 1e-4 * scale[todo] * descent[todo]
            good = todo[enough]
            new_x[good], new_loss[good] = trial[enough], trial_loss[enough]
            new_slope[good] = trial_slope[enough]
            accepted[good] = True
            scale[todo[~enough]] *= 0.5
        step = torch.zeros_like(x)
        turn = torch.zeros_like(x)
        step[index], turn[index] = new_x - x[index], new_slope - slope[index]
        gain = loss[index] - new_loss
        small = gain <= tolerance * (1e-12 + new_loss.abs())
        used[index] += accepted.long()
        x[index], loss[index], slope[index] = new_x, new_loss, new_slope
        stopped = ~accepted | small
        converged[index[stopped]] = True
        active[index[stopped]] = False
        # a zero pair is skipped by the recursion
        usable = (step * turn).sum(1) > 1e-10 * step.norm(dim=1) * turn.norm(dim=1)
        steps.append(step * usable[:, None])
        turns.append(turn * usable[:, None])
        if len(steps) > memory:
            steps.pop(0)
            turns.pop(0)
    return Minimum(
        x=x,
        loss=loss,
        converged=converged,
        iterations=used,
        evaluations=evaluations,
        nonfinite=nonfinite,
    )


def _two_loop(
    slope: Float[Tensor, "b p"], steps: list[Tensor], turns: list[Tensor]
) -> Float[Tensor, "b p"]:
    """H g with H the L-BFGS inverse Hessian; all-zero pairs change nothing."""
    q = slope.clone()
    kept = []
    gamma = slope.new_ones(len(slope))
    for s, y in zip(reversed(steps), reversed(turns), strict=True):
        curvature = (s * y).sum(1)
        rho = torch.where(curvature > 0, 1 / curvature.clamp(min=1e-30), 0.0)
        alpha = rho * (s * q).sum(1)
        q = q - alpha[:, None] * y
        kept.append((rho, alpha))
    for s, y in zip(steps, turns, strict=True):  # the newest non-zero pair scales H_0
        squared = (y * y).sum(1)
        gamma = torch.where(squared > 0, (s * y).sum(1) / squared.clamp(min=1e-30), gamma)
    q = gamma[:, None] * q
    for (rho, alpha), s, y in zip(reversed(kept), steps, turns, strict=True):
        beta = rho * (y * q).sum(1)
        q = q + (alpha - beta)[:, None] * s
    return q
