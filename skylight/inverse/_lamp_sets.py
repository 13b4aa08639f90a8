"""Sets of lamps that explain faces, to start from: pursuits of growing size.

The luminance of a face is explained by lamps in the directions of a set S and by light that is even
above the horizon and even below it, all non-negative::

    min_{a, b >= 0}  sum_p w_p (y_p - sum_{d in S} a_d T[p, d] - b_1 U[p] - b_2 L[p])^2

Sets grow as in matching pursuit, but :data:`BEAM` of the best are kept, not one: of two lamps that
are alike, the best single lamp is neither. Where ambient light may be anything, as in
:mod:`skylight.inverse._scan`, it takes a lamp's place.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse._least_squares import nnls
from skylight.models._lobes import LampedLight
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._observation import Observation

ROWS = 16
BEAM = 48
APART_RAD = math.radians(20.0)
ENERGIES = 0.05, 4.0  # of a lamp against the ambient light, to start from


@dataclass(frozen=True, kw_only=True)
class LampSets:
    """The best sets of k lamps: unit ``directions`` (s,k,3), and ``energies`` (s,k) relative to
    the ambient light's as :mod:`skylight.models._lamps` has them, means over the faces."""

    directions: Float[Tensor, "s k 3"]
    energies: Float[Tensor, "s k"]


class Pursuit:
    """Sets of lamps of growing size that explain some faces under one light.

    The faces may have any albedos and exposures; their energies that are left add up, each
    relative to the face's own.
    """

    def __init__(self, observations: Sequence[Observation]) -> None:
        self.grid = DirectionGrid.latlong(ROWS)
        self.faces = [_Gram.of(one) for one in observations]
        every = torch.arange(len(self.grid), device=self.faces[0].gram.device)[:, None]
        self._grown = [(every, self._left(every))]  # of one lamp, of two and so on

    @property
    def sets(self) -> Int[Tensor, "s k"]:
        """The largest so far, each lamp's number of its direction."""
        return self._grown[-1][0]

    @property
    def left(self) -> Float[Tensor, " s"]:
        """What they leave of the faces' energy."""
        return self._grown[-1][1]

    def _left(self, sets: Int[Tensor, "s k"]) -> Float[Tensor, " s"]:
        return torch.stack([face.left(sets) for face in self.faces]).sum(0)

    def grow(self) -> None:
        """One lamp more in each of the best sets."""
        best, count = self.sets[self.left.argsort()[:BEAM]], len(self.grid)
        more = torch.arange(count, device=best.device).repeat(len(best))
        grown = torch.cat([best.repeat_interleave(count, 0), more[:, None]], 1).sort(1).values
        grown = grown[(grown[:, 1:] > grown[:, :-1]).all(1)]
        # a set as one number: rows as such are compared one by one
        place = count ** torch.arange(grown.shape[1], device=best.device).flip(0)
        numbers = (grown * place).sum(1).unique()
        grown = numbers[:, None] // place % count
        self._grown.append((grown, self._left(grown)))

    def best(self, count: int, size: int | None = None) -> LampSets:
        """So many of the best sets, a lamp of each :data:`APART_RAD` from all of a better one.

        Of the largest sets so far, or of those of a ``size``.
        """
        every, left = self._grown[(size or 0) - 1]
        directions = self.grid.directions.to(left)
        chosen: list[Int[Tensor, " k"]] = []
        for candidate in every[left.argsort()[: 50 * count]]:
            towards = directions[candidate]
            nearest = [(towards @ directions[one].T).amax(1).min() for one in chosen]
            if all(float(cosine) < math.cos(APART_RAD) for cosine in nearest):
                chosen.append(candidate)
            if len(chosen) == count:
                break
        sets = torch.stack(chosen)
        energies = torch.stack([face.energies(sets) for face in self.faces]).mean(0)
        return LampSets(directions=directions[sets], energies=energies.clamp(*ENERGIES))

    def starts(self, model: LampedLight, count: int) -> Float[Tensor, "s c p"]:
        """Parameters to start from: in each of so many of the best sets of the model's number."""
        if model.count == 0:
            return model.starts().unflatten(0, (-1, len(model.ambient_starts())))
        while len(self._grown) < model.count:
            self.grow()
        sets = self.best(count, model.count)
        return model.starts_at(sets.directions, sets.energies)


@dataclass(frozen=True, kw_only=True)
class _Gram:
    """Products of the columns of one face's problem; the last two are ambient."""

    gram: Float[Tensor, "n n"]
    right: Float[Tensor, " n"]
    power: float
    solid_angles: Float[Tensor, " d"]

    @staticmethod
    def of(observation: Observation) -> "_Gram":
        root = observation.weights.double().sqrt()
        coarse = observation.on_rows(ROWS).transport
        matrix = coarse.matrix.double() * root[:, None]
        upper = len(coarse.grid) // 2
        both = matrix[:, :upper].sum(1), matrix[:, upper:].sum(1)
        columns = torch.cat([matrix, torch.stack(both, 1)], 1)
        y = luminance(observation.pixels).double() * root
        return _Gram(
            gram=columns.T @ columns,
            right=columns.T @ y,
            power=float(y @ y),
            solid_angles=coarse.grid.solid_angles.to(y),
        )

    def solution(self, sets: Int[Tensor, "s k"]) -> tuple[Tensor, Tensor]:
        """(radiance of each set's lamps and of the ambient light; their right sides)."""
        count = len(self.right)
        ambient = torch.tensor([count - 2, count - 1], device=sets.device).expand(len(sets), 2)
        chosen = torch.cat([sets, ambient], 1)
        right = self.right[chosen]
        return nnls(self.gram[chosen[:, :, None], chosen[:, None]], right), right

    def left(self, sets: Int[Tensor, "s k"]) -> Float[Tensor, " s"]:
        """The share of y^2 that each set leaves."""
        x, right = self.solution(sets)
        return 1 - (x * right).sum(1) / self.power

    def energies(self, sets: Int[Tensor, "s k"]) -> Float[Tensor, "s k"]:
        """The lamps' light over the ambient light."""
        x, _ = self.solution(sets)
        ambient = 0.5 * x[:, -2:].sum(1, keepdim=True)
        received = x[:, :-2] * self.solid_angles[sets] / (4 * math.pi)
        return received / ambient.clamp(min=1e-9 * float(x.max()))
