"""The atoms that correlate most with the residuals of several pursuits, found in one sweep."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.csc._positions import Chunk
from skylight.csc._sub_dictionaries import Plan, part_of

Values = Float[Tensor, "_ _ _ _"]  # (twist, filter, row, column); groups differ in size
Atom = tuple[int, tuple[int, int, int]]  # filter, (row, column, twist)


@dataclass(frozen=True, kw_only=True)
class Query:
    """What one pursuit looks for: its residual, in one colour, and the atoms that it has already.

    ``rivals`` atoms of correlations above ``least`` are wanted besides the best, the strongest.
    """

    residual: Float[Tensor, " k"]
    taken: Sequence[Atom]
    rivals: int = 0
    least: float = float("inf")


class Found(NamedTuple):
    """An atom and its correlation."""

    value: float
    atom: Atom


@dataclass(frozen=True, kw_only=True)
class Search:
    """The dictionary, and what of a correlation counts.

    ``absolute``: that of either sign. ``norms`` divide the first sub-dictionary's.
    """

    plans: Sequence[Plan]
    absolute: bool
    norms: Sequence[Values] | None = None

    def strongest(self, queries: Sequence[Query]) -> list[list[Found]]:
        """For each query the best atom, and after it the rivals, the best again among them.

        Values are looked at as they come and not kept: those of a dictionary without symmetry are
        tens of megabytes a residual.
        """
        residuals = torch.stack([query.residual for query in queries])
        least = residuals.new_tensor([query.least for query in queries])
        rivals, taken = any(query.rivals for query in queries), self._taken(queries)
        tops, others, sources = [], [], []
        for number, plan in enumerate(self.plans):
            for chunk in plan.correlation.in_chunks(residuals[:, plan.coordinates]):
                self._judge(number, chunk, taken)
                of_rows = chunk.values.amax(-1)
                tops.append(_best(chunk.values, of_rows))
                if rivals:
                    others.append(_above(chunk.values, of_rows, least[chunk.signals]))
                sources.append(_Source(number, chunk.group, *chunk[1:3], of_rows.shape[1:]))
        best = _numbered(tops, sources)
        more = _numbered(others, sources) if rivals else best[:0]
        return [
            self._ranked(best[best[:, 1] == i], 1)
            + self._ranked(more[more[:, 1] == i], query.rivals)
            for i, query in enumerate(queries)
        ]

    def everything(self, query: Query) -> list[tuple[Values, int, int]]:
        """All correlations, with their sub-dictionary and group; 0 for atoms in use."""
        taken, out = self._taken([query]), []
        for number, plan in enumerate(self.plans):
            for group, values in enumerate(
                plan.correlation.by_group(query.residual[plan.coordinates])
            ):
                chunk = values[None].movedim(1, 3)
                whole = Chunk(group, slice(0, 1), slice(0, values.shape[2]), chunk)
                self._judge(number, whole, taken)
                out.append((values, number, group))
        return out

    def named(self, number: int, group: int, spot: Sequence[int]) -> Atom:
        """The atom at (twist, place, row, column) of a group's values."""
        twist, place, row, column = spot
        plan = self.plans[number]
        return plan.first + plan.correlation.members(group)[place], (row, column, twist)

    def _taken(self, queries: Sequence[Query]) -> dict[tuple[int, int], Int[np.ndarray, "n 6"]]:
        """Atoms in use: query, place, row, twist, column, whether no rotation changes it.

        Per sub-dictionary and group.
        """
        out: dict[tuple[int, int], list[tuple[int, ...]]] = {}
        for i, query in enumerate(queries):
            for filter_, (row, column, twist) in query.taken:
                number = part_of(self.plans, filter_)
                plan = self.plans[number]
                group, place = plan.correlation.index[filter_ - plan.first]
                constant = filter_ in plan.constant
                here = out.setdefault((number, group), [])
                here.append((i, place, row, twist, column, constant))
        return {group: np.array(atoms) for group, atoms in out.items()}

    def _judge(
        self, number: int, chunk: Chunk, taken: dict[tuple[int, int], Int[np.ndarray, "n 6"]]
    ) -> None:
        """Signs dropped where either counts, norms divided by, 0 for atoms in use."""
        values = chunk.values
        if self.absolute:
            values.abs_()
        if self.norms is not None and number == 0:
            values /= self.norms[chunk.group][:, :, chunk.rows].movedim(0, 2)
        if (number, chunk.group) not in taken:
            return
        start = [chunk.signals.start, 0, chunk.rows.start, 0, 0, 0]
        atoms = taken[number, chunk.group] - start
        atoms = atoms[(atoms[:, 0] >= 0) & (atoms[:, 0] < len(values))]
        for signal, place, *_ in atoms[atoms[:, 5] == 1]:
            values[signal, place] = 0
        atoms[:, 3] %= values.shape[3]
        here = atoms[(atoms[:, 2] >= 0) & (atoms[:, 2] < values.shape[2]), :5]
        if len(here):
            values[tuple(torch.from_numpy(here.T.copy()).to(values.device))] = 0

    def _ranked(self, rows: Float[np.ndarray, "n 8"], count: int) -> list[Found]:
        """The ``count`` largest, the largest first."""
        if len(rows) > count:
            rows = rows[np.argsort(-rows[:, 0], kind="stable")[:count]]
        found = []
        for value, *where in rows.tolist():
            _, number, group, *spot = map(int, where)
            found.append(Found(value, self.named(number, group, spot)))
        return sorted(found, reverse=True)


class _Source(NamedTuple):
    """Where a chunk's values belong."""

    number: int
    group: int
    signals: slice
    rows: slice
    shape: tuple[int, ...]
    """Filters, rows and twists of one signal."""


def _best(
    values: Float[Tensor, "s f b t columns"], of_rows: Float[Tensor, "s f b t"]
) -> Float[Tensor, "s 4"]:
    """(value, signal, index over (f, b, t), column) of each signal's largest value."""
    signal = torch.arange(len(values), device=values.device)
    top, at = of_rows.flatten(1).max(1)
    column = values.flatten(1, 3)[signal, at].argmax(1)
    return torch.stack([top, *(each.double() for each in (signal, at, column))], 1)


def _above(
    values: Float[Tensor, "s f b t columns"],
    of_rows: Float[Tensor, "s f b t"],
    least: Float[Tensor, " s"],
) -> Float[Tensor, "n 4"]:
    """The same of all values above each signal's least; only rows that have any are looked at."""
    at = torch.nonzero(of_rows.flatten(1) > least[:, None])
    found = values.flatten(1, 3)[at[:, 0], at[:, 1]]
    which, column = torch.nonzero(found > least[at[:, :1]]).T
    above = found[which, column, None].double()
    return torch.cat([above, at[which].double(), column[:, None].double()], 1)


def _numbered(found: list[Tensor], sources: list[_Source]) -> Float[np.ndarray, "n 8"]:
    """(value, signal, sub-dictionary, group, twist, place, row, column) of all chunks' findings.

    One transfer from the device.
    """
    together = torch.cat(found).cpu().numpy()
    parts = np.split(together, np.cumsum([len(each) for each in found])[:-1])
    out = []
    for rows, source in zip(parts, sources, strict=True):
        value, signal, index, column = rows.T
        place, row, twist = np.unravel_index(index.astype(int), source.shape)
        whose = np.broadcast_to(np.array([[source.number], [source.group]]), (2, len(rows)))
        spot = twist, place, row + source.rows.start, column
        out.append(np.stack([value, signal + source.signals.start, *whose, *spot], 1))
    return np.concatenate(out)
