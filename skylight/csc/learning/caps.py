"""Dictionaries whose learned filters are sums of Gaussians in a spherical cap."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.optimize import nnls
from torch import Tensor, nn

from skylight.csc.dictionary import FilterBank, project_about_pole, sharpest_a, unit_rows
from skylight.errors import InputError
from skylight.sphere import harmonics, lobes
from skylight.sphere.frame import direction_from_angles

_VANISHED = 1e-9  # norm of a filter that the optimiser has put out


class CapFilterBank(FilterBank):
    """The filters ``learned`` of a dictionary as ``amounts @ lobes``; the others are constants.

    ``lobes`` are Gaussians about the nodes of a cap round the zenith, as sharp as the degree holds
    without ringing. ``amounts`` (m, n), the one parameter, starts at the non-negative least squares
    of the given filters. Non-negative amounts make filters that are light of some shape, blurred,
    which undershoot about as little as Gaussians do; after a step of an optimiser
    :meth:`project_` brings them back to that set.

    Parameters
    ----------
    bank : the dictionary to start from.
    learned : numbers of its filters.
    radius_rad : of the cap.
    signed : lets filters be negative.

    Raises
    ------
    InputError
        A learned filter that is none of the bank's, or the constant; a cap without room.
    """

    learned: Int[Tensor, " m"]
    lobes: Float[Tensor, "n k"]

    def __init__(
        self,
        bank: FilterBank,
        learned: Sequence[int],
        *,
        radius_rad: float = math.radians(30.0),
        signed: bool = False,
    ) -> None:
        super().__init__(bank.coefficients, bank.name, learnable=False)
        wrong = [i for i in learned if not 0 <= i < len(bank)]
        if wrong or not learned or len(set(learned)) != len(learned):
            raise InputError(
                f"learned filters are different ones of 0 to {len(bank) - 1}, got {list(learned)}"
            )
        if any(bank.constant[list(learned)]):
            raise InputError("the constant filter cannot be learned: leave it out of `learned`")
        if not 0 < radius_rad <= math.pi / 2:
            raise InputError(
                "the radius of learned filters is above 0 and at most 90 degrees, got "
                f"{math.degrees(radius_rad):g}"
            )
        self.signed = signed
        self.register_buffer("learned", torch.tensor(list(learned)), persistent=False)
        self.register_buffer("lobes", cap_lobes(radius_rad, bank.degree), persistent=False)
        self.amounts = nn.Parameter(_amounts(self.unnormalised[self.learned], self.lobes))
        self.project_()

    @property
    def coefficients(self) -> Float[Tensor, "m k"]:
        """Real SH coefficients of all filters, of unit norm."""
        return unit_rows(self.unnormalised.index_copy(0, self.learned, self.amounts @ self.lobes))

    @torch.no_grad()
    def project_(self) -> None:
        """Amounts of 0 or more (unless signed), and filters of unit norm, in place."""
        if not self.signed:
            self.amounts.clamp_(min=0)
        norms = (self.amounts @ self.lobes).norm(dim=1)
        for gone in torch.nonzero(norms < _VANISHED)[:, 0].tolist():
            self.amounts[gone] = 0
            self.amounts[gone, 0] = norms[gone] = 1.0
        self.amounts /= norms[:, None]


def cap_nodes(radius_rad: float, degree: int) -> Float[Tensor, "n 3"]:
    """Directions on a Fibonacci spiral that begins at the zenith.

    They are a standard deviation of that degree's sharpest Gaussian from each other, so that sums
    of Gaussians about them hold no gaps.
    """
    a = sharpest_a(degree)
    # exp(-a^2 theta^2): a variance of 1 / (2 a^2)
    count = max(1, round(4 * math.pi * math.sin(radius_rad / 2) ** 2 * 2 * a**2))
    i = torch.arange(count, dtype=torch.float64)
    theta = 2 * torch.asin(math.sin(radius_rad / 2) * torch.sqrt(i / count))
    golden = math.pi * (3 - math.sqrt(5))
    return direction_from_angles(math.pi - golden * i, theta)


def cap_lobes(radius_rad: float, degree: int) -> Float[Tensor, "n k"]:
    """Gaussians of unit norm about :func:`cap_nodes`, as sharp as the degree holds."""
    a = torch.tensor([[[sharpest_a(degree)]]], dtype=torch.float64)
    gaussian = project_about_pole(lambda theta, phi: lobes.gaussian(theta, a), degree, columns=1)[0]
    # one column of phi says nothing about the orders that are left out
    bands = harmonics.zonal_factors(gaussian) / gaussian[harmonics.orders(degree) == 0].norm()
    basis = harmonics.evaluate_about_zenith(cap_nodes(radius_rad, degree), degree)
    return basis * bands[harmonics.bands(degree)]


def _amounts(
    filters: Float[Tensor, "m k"], gaussians: Float[Tensor, "n k"]
) -> Float[Tensor, "m n"]:
    """The amounts >= 0 whose sums are nearest to these filters."""
    q, r = np.linalg.qr(gaussians.T.numpy())
    right = filters.double().numpy() @ q
    rows = [nnls(r, row, maxiter=30 * len(gaussians))[0] for row in right]
    return torch.from_numpy(np.stack(rows))
