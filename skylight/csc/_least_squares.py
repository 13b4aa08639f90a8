"""The least squares of a pursuit: errors as quadratic forms, and the weights that minimise them.

Coding a map and recovering light from shading are one problem: with c the coordinates of the
coded signal and A the linear map from c to what was observed, ::

    |x - A c|^2_W = x^T W x - 2 b^T c + c^T H c,    b = A^T W x,    H = A^T W A,

so a pursuit asks for b and the product with H alone (:class:`Quadratic`). :class:`ActiveSet` finds
the weights of the chosen atoms from their Gram matrix ``G_ij = a_i^T H a_j``: free, not negative,
or with a weak L1 norm.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import solve_triangular
from torch import Tensor

from skylight.sphere._latlong_transform import LatLongTransform

_DEPENDENT = 1e-10  # relative pivot below which an atom is a combination of the others
_OPTIMAL = 1e-11  # relative gradient that counts as zero


@runtime_checkable
class Quadratic(Protocol):
    """``energy - 2 b^T c + c^T H c`` per colour; ``target`` is b."""

    @property
    def target(self) -> Float[Tensor, "k c"]: ...

    @property
    def energy(self) -> Float[Tensor, " c"]: ...

    def hessian(self, coefficients: Float[Tensor, "k *c"]) -> Float[Tensor, "k *c"]:
        """H c."""
        ...


@dataclass(frozen=True, kw_only=True)
class SampledSignal:
    """The error of a lat-long map: A = (B, 1), W = the pixels' solid angles.

    Coordinates are spherical harmonic coefficients, B their basis at the pixels, and, where
    ``pixels``, the pixels' own values after them.
    """

    transform: LatLongTransform
    pixels: bool
    target: Float[Tensor, "k c"]
    energy: Float[Tensor, " c"]

    @staticmethod
    def of(
        maps: Float[Tensor, "h w c"], transform: LatLongTransform, *, pixels: bool = False
    ) -> "SampledSignal":
        planes = maps.movedim(-1, 0)
        return SampledSignal(
            transform=transform,
            pixels=pixels,
            target=_adjoint(planes, transform, pixels=pixels).movedim(-1, 0),
            energy=(planes.square() * transform.solid_angles.to(planes)).sum((1, 2)),
        )

    def hessian(self, coefficients: Float[Tensor, "k *c"]) -> Float[Tensor, "k *c"]:
        rows = coefficients.movedim(0, -1)
        size = (self.transform.degree + 1) ** 2
        maps = self.transform.synthesise(rows[..., :size])
        if self.pixels:
            maps = maps + rows[..., size:].reshape(maps.shape)
        return _adjoint(maps, self.transform, pixels=self.pixels).movedim(-1, 0)


def _adjoint(
    maps: Float[Tensor, "*c h w"], transform: LatLongTransform, *, pixels: bool
) -> Float[Tensor, "*c k"]:
    """A^T W x."""
    coefficients = transform.analyse(maps)
    if not pixels:
        return coefficients
    return torch.cat([coefficients, (maps * transform.solid_angles.to(maps)).flatten(-2)], -1)


@dataclass(frozen=True, kw_only=True)
class LinearObservation:
    """H given as a matrix: light seen through a transport matrix."""

    matrix: Float[Tensor, "k k"]
    target: Float[Tensor, "k c"]
    energy: Float[Tensor, " c"]

    @staticmethod
    def of(
        operator: Float[Tensor, "m k"], values: Float[Tensor, "m c"], weights: Float[Tensor, " m"]
    ) -> "LinearObservation":
        weighted = operator * weights[:, None]
        return LinearObservation(
            matrix=operator.T @ weighted,
            target=weighted.T @ values,
            energy=weights @ values.square(),
        )

    def hessian(self, coefficients: Float[Tensor, "k *c"]) -> Float[Tensor, "k *c"]:
        return torch.einsum("jk,k...->j...", self.matrix.to(coefficients), coefficients)


class CholeskyFactor:
    """Lower factor L of ``G[P, P] = L L^T`` for a growing and shrinking list P of atoms.

    An atom is appended by one triangular solve and removed by a rank-one update of the rows after
    it (Golub and Van Loan, 4th ed., 6.5.4), ``O(|P|^2)`` each.
    """

    def __init__(self) -> None:
        self.members: list[int] = []
        self._lower = np.zeros((16, 16))

    def append(self, atom: int, gram: Float[np.ndarray, "s s"]) -> bool:
        """Add an atom; False, and nothing happens, where it depends on those present."""
        n = len(self.members)
        if n == len(self._lower):
            self._lower = np.pad(self._lower, (0, n))
        row = np.zeros(0)
        if n:
            row = solve_triangular(self._lower[:n, :n], gram[self.members, atom], lower=True)
        pivot = gram[atom, atom] - row @ row
        if pivot <= _DEPENDENT * gram[atom, atom]:
            return False
        self._lower[n, :n] = row
        self._lower[n, n] = np.sqrt(pivot)
        self.members.append(atom)
        return True

    def remove(self, atom: int) -> None:
        place = self.members.index(atom)
        n = len(self.members)
        gone = self._lower[place + 1 : n, place].copy()
        self._lower[place : n - 1] = self._lower[place + 1 : n]
        self._lower[place : n - 1, place : n - 1] = self._lower[place : n - 1, place + 1 : n]
        # the trailing block L33 L33^T gains gone gone^T
        for k in range(place, n - 1):
            column = self._lower[k : n - 1, k]
            rest = gone[k - place :]
            pivot = np.hypot(column[0], rest[0])
            cosine, sine = pivot / column[0], rest[0] / column[0]
            updated = (column + sine * rest) / cosine
            gone[k - place :] = cosine * rest - sine * updated
            self._lower[k : n - 1, k] = updated
        self._lower[n - 1] = 0
        self._lower[:, n - 1] = 0
        del self.members[place]

    def solve(self, right: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """``G[P, P]^-1 right``."""
        n = len(self.members)
        half = solve_triangular(self._lower[:n, :n], right, lower=True)
        return solve_triangular(self._lower[:n, :n], half, lower=True, trans=1)


class ActiveSet:
    """``argmin_z  z^T G z / 2 - b^T z + penalty |z|_1``, with z >= 0 where asked.

    The active-set method of Lawson and Hanson (1974, ch. 23) for non-negative z; with signs, z is
    the difference of two non-negative parts, of which no atom uses both, which is the
    feature-sign search of Lee et al. 2007. Exact after finitely many steps. Without penalty and
    constraint it is plain least squares. ``weights`` and the factor outlive a call, so after an
    atom was added (a row and column more in G) one or two solves are enough.
    """

    def __init__(self, *, penalty: float = 0.0, nonnegative: bool = False) -> None:
        self.penalty, self.nonnegative = penalty, nonnegative
        self.weights = np.zeros(0)
        self._signs = np.zeros(0)
        self._factor = CholeskyFactor()

    def grow(self) -> None:
        """One atom more, not used yet."""
        self.weights = np.append(self.weights, 0.0)
        self._signs = np.append(self._signs, 0.0)

    def drop(self, atom: int) -> None:
        """Forget an atom; those after it move up by one."""
        if atom in self._factor.members:
            self._factor.remove(atom)
        self._factor.members = [m - (m > atom) for m in self._factor.members]
        self.weights, self._signs = np.delete(self.weights, atom), np.delete(self._signs, atom)

    def solve(
        self, gram: Float[np.ndarray, "s s"], right: Float[np.ndarray, " s"]
    ) -> Float[np.ndarray, " s"]:
        """The minimiser; G must be that of the last call but for atoms added and dropped since."""
        tolerance = _OPTIMAL * max(1e-300, float(np.abs(right).max(initial=0)))
        useless: set[int] = set()
        last = -1
        for _ in range(20 * len(right) + 20):
            before = set(self._factor.members)
            self._descend(right)
            if before - set(self._factor.members) - {last}:
                useless.clear()  # what depended on those that left may be of use now
            elif last >= 0 and last not in self._factor.members:
                useless.add(last)  # thrown out at once: its gain is rounding
            gradient = right - gram @ self.weights
            gain = gradient if self.nonnegative else np.abs(gradient)
            gain = gain - self.penalty
            gain[[*self._factor.members, *useless]] = -np.inf
            best = int(gain.argmax()) if len(gain) else 0
            if not len(gain) or gain[best] <= tolerance:
                return self.weights
            last = best
            if self._factor.append(best, gram):
                self._signs[best] = np.sign(gradient[best])
            else:
                useless.add(best)
        raise RuntimeError(f"the active set of {len(right)} atoms did not converge")

    def _descend(self, right: Float[np.ndarray, " s"]) -> None:
        """To the minimum over the atoms in use, leaving out those that would change sign."""
        bound = self.nonnegative or self.penalty > 0
        while self._factor.members:
            used = self._factor.members
            target = self._factor.solve(right[used] - self.penalty * self._signs[used])
            wrong = target * self._signs[used] <= 0
            if not bound or not wrong.any():
                self.weights[used] = target
                return
            now = self.weights[used]
            # a new atom has weight 0 and moves the right way unless rounding says otherwise
            share = (now / np.where(now == target, 1.0, now - target))[wrong]
            step = float(np.clip(share, 0, 1).min())
            moved = now + step * (target - now)
            first = np.flatnonzero(wrong)[share.argmin()]
            out = [
                a
                for i, a in enumerate(used)
                if i == first or (wrong[i] and moved[i] * self._signs[a] <= 0)
            ]
            self.weights[used] = moved
            for atom in out:
                self._factor.remove(atom)
                self.weights[atom] = 0.0
                self._signs[atom] = 0.0
