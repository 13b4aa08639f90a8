"""Non-negative least squares of many small problems at once."""

import torch
from jaxtyping import Float
from scipy.optimize import nnls as active_set
from torch import Tensor

_PATIENCE = 3  # exchanges that make no progress before one unknown at a time is exchanged
_MOST = 200  # pivots of all problems together; what is left then is solved one by one


def nnls(
    gram: Float[Tensor, "b k k"],
    right: Float[Tensor, "b k"],
    *,
    start: Float[Tensor, "b k"] | None = None,
) -> Float[Tensor, "b k"]:
    """argmin_{x >= 0} x^T G x / 2 - r^T x of b problems, by block principal pivoting.

    Unknowns are free or zero. The free ones are those of the unconstrained problem, and all that
    are wrong (free and negative, or zero with a negative slope) change sides, until none is; where
    that cycles, only the last one does (Murty's rule), which ends: Kim & Park, "Fast nonnegative
    matrix factorization: an active-set-like method and comparisons", SIAM J. Sci. Comput. 33(6),
    2011. What is positive in ``start`` is free at first; near starts take few pivots.

    G may be singular: 1e-10 of its diagonal is added to it. In single precision, where rounding
    makes it a little indefinite, that is 1e-6 of the largest of the diagonal, which therefore
    should be of one order. A slope of less than 1e-9 of the largest ``|r|`` counts as 0.
    Unknowns whose row and right side are zero are 0. Computed in double precision. Where columns
    are nearly dependent Murty's rule may take very many pivots: problems that are left after 200
    are solved by an active set method, one by one.
    """
    count, size = right.shape
    whole, wanted = gram.double(), right.double()
    diagonal = whole.diagonal(dim1=1, dim2=2)
    if gram.dtype == torch.float64:
        ridge = 1e-10 * diagonal
    else:
        ridge = 1e-6 * diagonal.amax(1, keepdim=True)
    whole = whole + torch.diag_embed(ridge + (diagonal <= 0))
    limit = 1e-9 * wanted.abs().amax(1, keepdim=True)
    free = torch.zeros_like(wanted) > 0 if start is None else start > 0
    order = torch.arange(size, device=right.device)
    fewest = torch.full((count,), size + 1, device=right.device)
    patience = torch.full_like(fewest, _PATIENCE)
    solution = torch.zeros_like(wanted)
    rows = torch.arange(count, device=right.device)  # of what is not solved yet
    for _ in range(_MOST):
        chosen = free.double()
        system = whole * chosen[:, :, None] * chosen[:, None]
        system.diagonal(dim1=1, dim2=2).add_(1 - chosen)
        x = torch.linalg.solve(system, (wanted * chosen)[..., None])
        slope = (whole @ x)[..., 0] - wanted
        x = x[..., 0]
        wrong = torch.where(free, x * diagonal < -limit, slope < -limit)
        amount = wrong.sum(1)
        solution[rows] = x.clamp(min=0)
        left = amount > 0
        if not bool(left.any()):
            break
        progress = amount < fewest
        patience = torch.where(progress, _PATIENCE, patience - 1)
        fewest = torch.minimum(fewest, amount)
        last = order == torch.where(wrong, order, -1).amax(1, keepdim=True)
        exchanged = torch.where((patience >= 0)[:, None], wrong, last)
        free, whole, wanted, diagonal, limit, fewest, patience, rows = (
            each[left]
            for each in (free ^ exchanged, whole, wanted, diagonal, limit, fewest, patience, rows)
        )
    else:
        for row, matrix, target in zip(rows, whole, wanted, strict=True):
            solution[int(row)] = _by_active_set(matrix, target)
    return solution.to(right)


def _by_active_set(gram: Float[Tensor, "k k"], right: Float[Tensor, " k"]) -> Float[Tensor, " k"]:
    """Of one problem, as min |R x - y| with G = R^T R and R^T y = r.

    Eigenvalues that rounding made negative, or almost 0, are 1e-10 of the largest.
    """
    values, vectors = torch.linalg.eigh(gram)
    scales = values.clamp(min=1e-10 * float(values[-1])).sqrt()
    root, y = scales[:, None] * vectors.T, (vectors.T @ right) / scales
    found, _ = active_set(root.cpu().numpy(), y.cpu().numpy(), maxiter=100 * len(right))
    return torch.from_numpy(found).to(right)
