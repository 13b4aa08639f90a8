"""Filters that are fitted to what they are used for: dictionary learning, beyond the thesis.

With maps x_n, their codes and A the linear map from coefficients to pixels, the error is ::

    F = mean_n |x_n - A sum_j R_nj d_(f_nj) w_nj^T|^2 / |x_n|^2

and learning takes turns (Engan, Aase, Husoy 1999, "Method of optimal directions"; Mairal, Bach,
Ponce, Sapiro 2009, "Online dictionary learning"): find codes for the filters by pursuit; then, with
what stands where fixed, F is a quadratic of the filters, which descends by gradient, and another
one of the weights, which least squares solve. No turn raises F: a map keeps its old code where the
pursuit, being greedy, finds a worse one.

A learned filter is a sum of Gaussians (:class:`~skylight.csc.caps.Cap`) with amounts that by
default are not negative, so it is light of some shape, blurred, and undershoots about as little as
they do, without a penalty to weigh.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.csc.active_set import ActiveSet
from skylight.csc.caps import Cap, Turning
from skylight.csc.dictionary import FilterBank
from skylight.csc.layers import Layer
from skylight.csc.objective import SampledSignal
from skylight.csc.positions import Positions
from skylight.csc.pursuit import Pursuit, PursuitOptions, Support
from skylight.csc.search import pursue
from skylight.errors import InputError
from skylight.sphere import harmonics
from skylight.sphere.latlong_transform import LatLongTransform

_MAPS_AT_ONCE = 8  # whose atoms are turned together: 8 MB for 64 activations each, several times
_VANISHED = 1e-9  # norm of a filter that the descent has put out


@dataclass(frozen=True, kw_only=True)
class LearningOptions:
    """How to learn.

    A code has ``activations``, found under ``pursuit``; between two searches there are ``rounds``
    of ``steps`` gradient steps in the filters and a fit of all weights. ``radius_rad`` is that of
    the filters' cap, and ``signed`` lets them be negative.
    """

    activations: int = 36
    rounds: int = 3
    steps: int = 15
    radius_rad: float = math.radians(30.0)
    signed: bool = False
    pursuit: PursuitOptions = field(default_factory=PursuitOptions)

    def __post_init__(self) -> None:
        for name in ("activations", "rounds", "steps"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be at least 1, got {getattr(self, name)}")
        if not 0 < self.radius_rad <= math.pi / 2:
            raise InputError(
                "the radius of learned filters is above 0 and at most 90 degrees, got "
                f"{math.degrees(self.radius_rad):g}"
            )


@dataclass(kw_only=True)
class _Map:
    """A map to learn from, its code, and the error that the code leaves (all maps' share of F)."""

    signal: SampledSignal
    energy: float
    support: Support | None = None

    @property
    def error(self) -> float:
        return 1.0 if self.support is None else max(0.0, self.support.error) / self.energy


class DictionaryLearner:
    """Learns filters ``learnable`` of ``bank`` from maps; the others stay as they are.

    A learned filter starts as the nearest sum of its cap's Gaussians. Maps have fewer than 64 rows:
    finer ones are coded with finer layers, which nothing is learned of.

    Raises
    ------
    InputError
        Maps that cannot be coded, or a learnable filter that is none, or the constant.
    """

    def __init__(
        self,
        maps: Float[Tensor, "n h w 3"],
        bank: FilterBank,
        learnable: Sequence[int],
        options: LearningOptions | None = None,
    ) -> None:
        self.options = options or LearningOptions()
        self._name = bank.name
        self._maps: list[_Map] = []
        self._check(maps, bank, learnable)
        self.learnable = list(learnable)
        self.cap = Cap(self.options.radius_rad, bank.degree)
        self._rows = bank.coefficients.detach().clone()
        self._amounts = self.cap.fit(self._rows[self.learnable])
        self._unused = set(range(len(self.learnable)))
        for i in torch.nonzero(self._amounts.sum(1) == 0)[:, 0].tolist():
            self._amounts[i, 0] = 1.0  # nothing of it lies in the cap
        self._normalise()
        self.turning = Turning(bank.degree, Positions())
        self._transform = LatLongTransform(bank.degree, maps.shape[1])
        for one in maps.double():
            signal = SampledSignal.of(one, self._transform)
            self._maps.append(_Map(signal=signal, energy=float(signal.energy.sum())))
        if any(one.energy == 0 for one in self._maps):
            raise InputError("a map is black: leave it out")
        self.errors: list[float] = []
        """F after every epoch."""

    def _check(
        self, maps: Float[Tensor, "n h w 3"], bank: FilterBank, learnable: Sequence[int]
    ) -> None:
        count, height, width, _ = maps.shape
        if count == 0 or width != 2 * height or height >= 64:
            raise InputError(
                "filters are learned from one or more full lat-long maps of fewer than 64 rows, "
                f"got {count} of {height}x{width}: resize them, to 32 rows say"
            )
        if bank.coefficients.shape[1] > height * width:
            raise InputError(
                f"filters of degree {bank.degree} have {bank.coefficients.shape[1]} coefficients, "
                f"a map of {height}x{width} only {height * width} directions: use finer maps or a "
                "dictionary of lower degree"
            )
        if not bool(maps.isfinite().all()):
            raise InputError("a map has values that are NaN or infinite: leave it out")
        wrong = [i for i in learnable if not 0 <= i < len(bank)]
        if wrong or not learnable or len(set(learnable)) != len(learnable):
            raise InputError(
                f"learnable filters are different ones of 0 to {len(bank) - 1}, got "
                f"{list(learnable)}"
            )
        if any(bank.constant[list(learnable)]):
            raise InputError("the constant filter cannot be learned: leave it out of `learnable`")

    @property
    def bank(self) -> FilterBank:
        """The dictionary as it is now."""
        return FilterBank(self._rows, self._name)

    @property
    def error(self) -> float:
        """F, the mean relative squared error; 1 for a map that has no code yet."""
        return sum(one.error for one in self._maps) / len(self._maps)

    @property
    def used(self) -> int:
        """Learned filters that are active in a code."""
        return len(self.learnable) - len(self._unused)

    @property
    def share(self) -> float:
        """Of all activations, those of learned filters."""
        active = [f for one in self._maps if one.support for f in one.support.filters.tolist()]
        return sum(f in self.learnable for f in active) / max(1, len(active))

    def epoch(self, progress: Callable[[float], None] | None = None) -> float:
        """Codes, rounds of filters and weights, and a new start for what is not used: F."""
        if self.errors:
            self.replace_unused()
        self.code(progress)
        for _ in range(self.options.rounds):
            self.descend()
            self.refit()
        self.errors.append(self.error)
        return self.error

    def code(self, progress: Callable[[float], None] | None = None) -> None:
        """A new code for every map on which it is better than the one it has."""
        layer = Layer(self.bank, self.turning.positions)
        for n, one in enumerate(self._maps):
            pursuit = Pursuit([layer], one.signal, self.options.pursuit)
            (found,) = pursue(pursuit, [self.options.activations])
            # the L1 norm puts atoms out that plain least squares would give weight again
            kept = found.weights.abs().sum(1) > 0
            found = self._fitted(one.signal, found.filters[kept], found.places[kept])
            if one.support is None or found.error < one.support.error:
                one.support = found
            if progress is not None:
                progress((n + 1) / len(self._maps))
        active = {f for one in self._maps if one.support for f in one.support.filters.tolist()}
        self._unused = {i for i, f in enumerate(self.learnable) if f not in active}

    def refit(self) -> None:
        """The best weights of every code, by least squares in each colour."""
        for one in self._maps:
            if one.support is not None:
                fitted = self._fitted(one.signal, one.support.filters, one.support.places)
                # a fit can be worse by rounding
                one.support = min(fitted, self._measured(one), key=lambda s: s.error)

    def _measured(self, one: _Map) -> Support:
        """The support of a map with the error that it has now."""
        assert one.support is not None
        c = self._turned(one.support).T @ one.support.weights
        missed = one.signal.energy.sum() - _explained(c, one.signal)
        return replace(one.support, error=float(missed))

    def _turned(self, support: Support) -> Float[Tensor, "s k"]:
        return self.turning(self._rows[support.filters], support.places)

    def _fitted(
        self, signal: SampledSignal, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Support:
        atoms = self.turning(self._rows[filters], places)
        gram = (atoms @ signal.hessian(atoms.T)).numpy()
        right = (atoms @ signal.target).numpy()
        columns = []
        for colour in range(right.shape[1]):
            fit = ActiveSet(nonnegative=self.options.pursuit.weights == "nonnegative")
            for _ in range(len(right)):
                fit.grow()
            columns.append(fit.solve(gram, right[:, colour]))
        weights = np.stack(columns, 1)
        explained = np.einsum("sc,sc->", weights, 2 * right - gram @ weights)
        return Support(
            filters=filters,
            places=places,
            weights=torch.from_numpy(weights),
            error=float(signal.energy.sum()) - float(explained),
        )

    def descend(self) -> list[float]:
        """Gradient steps in the learned filters under fixed codes: F before and after each.

        Spectral projected gradients (Birgin, Martinez, Raydan 2000): steps of Barzilai and
        Borwein's length, cut to what is allowed, and along each the exact minimum of the
        quadratic. Amounts are scaled by the root of their filter's squared weights, which makes F
        curve alike in all of them.
        """
        problem = _FilterProblem(self)
        x = self._amounts * problem.scale[:, None]
        value, gradient = problem.value(x, gradient=True)
        values, length = [value], None
        for _ in range(self.options.steps):
            # first step: as long as the error would be gone, were F a straight line
            length = length or value / max(1e-300, float(gradient.square().sum()))
            target = x - length * gradient
            move = (target if self.options.signed else target.clamp(min=0)) - x
            slope = float((gradient * move).sum())
            if slope >= 0 or value <= 0:
                break
            curvature = problem.value(x + move)[0] - value - slope  # half of it
            share = 1.0 if curvature <= 0 else min(1.0, -slope / (2 * curvature))
            before, old = gradient, value
            moved = x + share * move
            value, gradient = problem.value(moved, gradient=True)
            if value > old:  # rounding: there is no more to gain
                break
            step, bend = moved - x, gradient - before
            curved = float((step * bend).sum())
            length = float(step.square().sum()) / curved if curved > 0 else None
            x = moved
            values.append(value)
        self._amounts = torch.where(
            problem.scale[:, None] > 0, x / problem.scale.clamp(min=1e-300)[:, None], self._amounts
        )
        self._normalise()
        return values

    def _normalise(self) -> None:
        """Unit filters again, and the weights that make up for it."""
        norms = (self._amounts @ self.cap.lobes).norm(dim=1)
        gone = norms < _VANISHED
        if gone.any():  # a weight of 0 stands for it, so any filter does
            self._amounts[gone] = 0.0
            self._amounts[gone, 0] = 1.0
        self._amounts = self._amounts / torch.where(gone, torch.ones_like(norms), norms)[:, None]
        self._rows[self.learnable] = self._amounts @ self.cap.lobes
        self._rows = self._rows / self._rows.norm(dim=1, keepdim=True)
        factor = torch.ones(len(self._rows), dtype=torch.float64)
        factor[self.learnable] = torch.where(gone, torch.zeros_like(norms), norms)
        for one in self._maps:
            if one.support is not None:
                weights = one.support.weights * factor[one.support.filters][:, None]
                one.support = replace(one.support, weights=weights)
                one.support = self._measured(one)

    def replace_unused(self) -> int:
        """New shapes for filters that no code uses: residuals where maps are explained worst.

        Of every map the cap in which most of its energy is missing, those maps first that miss
        most; the residual's principal colour, tapered, and of its two signs the stronger. Returns
        how many there were.
        """
        if not self._unused:
            return 0
        worst = sorted((self._worst_cap(one) for one in self._maps), key=lambda w: -w[0])
        replaced = list(zip(sorted(self._unused), worst, strict=False))
        for i, (_, values) in replaced:
            self._amounts[i] = values
            self._unused.remove(i)
        self._normalise()
        return len(replaced)

    def _worst_cap(self, one: _Map) -> tuple[float, Float[Tensor, " n"]]:
        residual = one.signal.target
        if one.support is not None:
            residual = residual - one.signal.hessian(
                self._turned(one.support).T @ one.support.weights
            )
        grey = residual @ torch.linalg.eigh(residual.T @ residual).eigenvectors[:, -1]
        l = harmonics.bands(self._transform.degree).double()  # noqa: E741
        # a Gaussian whose standard deviation is half the cap's radius
        blur = torch.exp(-l * (l + 1) * (self.options.radius_rad / 2) ** 2 / 2)
        missing = self._transform.synthesise(grey).square()
        missing = self._transform.synthesise(self._transform.analyse(missing) * blur)
        row, column = divmod(int(missing.argmax()), missing.shape[1])
        height, width = missing.shape
        alpha, beta = 2 * math.pi * (1 - (column + 0.5) / width), math.pi * (row + 0.5) / height
        values = self.cap.at(grey, alpha, beta) * self.cap.taper
        if float(values.clamp(min=0).square().sum()) < float(values.clamp(max=0).square().sum()):
            values = -values
        if not self.options.signed:
            values = values.clamp(min=0)
        return float(missing.max()) / one.energy, values

    def state(self) -> dict[str, Any]:
        """All that has been learned, as tensors and numbers; :meth:`restore` goes on from it."""
        codes = [
            {"filters": s.filters, "places": s.places, "weights": s.weights, "error": s.error}
            for s in (one.support for one in self._maps)
            if s is not None
        ]
        return {
            "amounts": self._amounts.clone(),
            "rows": self._rows.clone(),
            "unused": sorted(self._unused),
            "errors": list(self.errors),
            "codes": codes,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from the :meth:`state` of a learner of the same maps and bank."""
        self._amounts, self._rows = state["amounts"].clone(), state["rows"].clone()
        self._unused, self.errors = set(state["unused"]), list(state["errors"])
        if state["codes"]:
            for one, code in zip(self._maps, state["codes"], strict=True):
                one.support = Support(**code)


class _FilterProblem:
    """F as a quadratic of the learned filters' scaled amounts, codes fixed.

    What the other filters give is taken off the maps once.
    """

    def __init__(self, learner: DictionaryLearner) -> None:
        self._learner = learner
        self._coded: list[_Map] = []
        number = torch.full((len(learner._rows),), -1)
        number[learner.learnable] = torch.arange(len(learner.learnable))
        squares = torch.zeros(len(learner.learnable), dtype=torch.float64)
        for one in learner._maps:
            assert one.support is not None, "maps are coded before filters are fitted"
            mine = number[one.support.filters] >= 0
            rest = learner._turned(_some(one.support, ~mine)).T @ one.support.weights[~mine]
            colours = one.signal.target.shape[1]
            left = one.signal.energy.sum() - _explained(rest, one.signal)
            signal = replace(
                one.signal,
                target=one.signal.target - one.signal.hessian(rest),
                # in equal parts: their sum is all that is asked for
                energy=(left / colours).expand(colours),
            )
            own = _some(one.support, mine)
            own = replace(own, filters=number[own.filters])
            squares.index_add_(0, own.filters, own.weights.square().sum(1) / one.energy)
            self._coded.append(_Map(signal=signal, energy=one.energy, support=own))
        self.scale = squares.sqrt()

    def value(
        self, scaled: Float[Tensor, "m n"], *, gradient: bool = False
    ) -> tuple[float, Float[Tensor, "m n"]]:
        """F, and its gradient (zeros where it is not asked for)."""
        lobes, count = self._learner.cap.lobes, len(self._coded)
        inverse = torch.where(self.scale > 0, 1 / self.scale, torch.zeros_like(self.scale))
        total, slope = 0.0, torch.zeros_like(scaled)
        for start in range(0, count, _MAPS_AT_ONCE):
            x = scaled.detach().clone().requires_grad_(gradient)
            filters = (x * inverse[:, None]) @ lobes
            part = self._part(filters, self._coded[start : start + _MAPS_AT_ONCE]) / count
            total += float(part.detach())
            if gradient and part.requires_grad:
                slope += torch.autograd.grad(part, x)[0]
        return total, slope

    def _part(self, filters: Float[Tensor, "m k"], coded: list[_Map]) -> Float[Tensor, ""]:
        """The sum of these maps' relative squared errors."""
        supports = [one.support for one in coded if one.support is not None]
        chosen = torch.cat([own.filters for own in supports])
        places = torch.cat([own.places for own in supports])
        atoms = self._learner.turning(filters[chosen], places)
        total = filters.new_zeros(())
        each = atoms.split([len(own) for own in supports])
        for one, own, here in zip(coded, supports, each, strict=True):
            explained = _explained(here.T @ own.weights, one.signal)
            total = total + (one.signal.energy.sum() - explained) / one.energy
        return total


def _explained(c: Float[Tensor, "k c"], signal: SampledSignal) -> Float[Tensor, ""]:
    """``2 b^T c - c^T H c`` of all colours: what c takes off the squared error."""
    return (c * (2 * signal.target - signal.hessian(c))).sum()


def _some(support: Support, chosen: Bool[Tensor, " s"]) -> Support:
    return replace(
        support,
        filters=support.filters[chosen],
        places=support.places[chosen],
        weights=support.weights[chosen],
    )
