"""A row of the page, and how what was measured is compared with what the thesis states."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from skylight.evaluation._run import Rows
from skylight.evaluation._tables import METRICS, ThesisTable
from tools.records import results


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One table or figure, or a row of it: what the thesis states, and ours.

    ``cells`` are its comparisons, true where ours is at or past the thesis; it is met where all
    are, and ``met`` is None where there are none. ``uncounted`` says why they are not the thesis'
    own: a limit of ours, a constant chosen by its figure, other data, another network.
    """

    name: str
    shows: str
    thesis: str = ""
    ours: str
    cells: tuple[bool, ...] = ()
    uncounted: str = ""
    where: str  # the command or page that makes it
    records: tuple[str, ...] = ()

    @property
    def met(self) -> bool | None:
        return all(self.cells) if self.cells else None

    @property
    def verdict(self) -> str:
        if self.met is None:
            return ""
        if self.uncounted:
            return f"({'yes' if self.met else 'no'}: {self.uncounted})"
        return "yes" if self.met else "**no**"


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A number of the thesis beside ours, which counts unrounded."""

    thesis: float
    ours: float
    more_is_better: bool = False

    @property
    def met(self) -> bool:
        return self.ours >= self.thesis if self.more_is_better else self.ours <= self.thesis


def beside(
    name: str,
    shows: str,
    thesis: Sequence[float],
    ours: Sequence[float],
    where: str,
    *,
    records: tuple[str, ...],
    digits: int = 3,
    more_is_better: bool = False,
    uncounted: str = "",
) -> Figure:
    """Numbers beside the thesis', met where each one is."""
    return Figure(
        name=name,
        shows=shows,
        thesis=numbers(thesis, digits),
        ours=numbers(ours, digits),
        cells=tuple(
            Compared(thesis=t, ours=o, more_is_better=more_is_better).met
            for t, o in zip(thesis, ours, strict=True)
        ),
        uncounted=uncounted,
        where=where,
        records=records,
    )


# The thesis crops 13 degrees "around the brightest point in the sky probe": of each map, or of the
# truth? Its one number is compared with both readings, and the cell is met where both are.
_BY_PIXEL = "sun_dw_mae_fixed"
_LABELS = dict(zip(METRICS, ("MAE", "RMSE", "si-RMSE", "Full", "Sky", "Sun", "angle"), strict=True))


def thesis_row(
    name: str,
    thesis: ThesisTable,
    method: str,
    ours: Rows,
    row: str,
    *,
    shows: str,
    where: str,
    record: str,
    uncounted: str = "",
) -> Figure:
    """A row of Tables 5.1 and 5.2: seven metrics, of which Sun has two readings."""
    of = [thesis.cell(method, metric)[0] for metric in METRICS]
    found = [ours[row][metric]["mean"] for metric in METRICS]
    by_pixel = ours[row][_BY_PIXEL]["mean"]
    cells, worse = [], []
    for metric, theirs, value in zip(METRICS, of, found, strict=True):
        readings = {_LABELS[metric]: value}
        if metric == "sun_dw_mae":
            readings["Sun by pixel"] = by_pixel
        past = [label for label, v in readings.items() if not Compared(thesis=theirs, ours=v).met]
        cells.append(not past)
        worse += past
    n, suns = ours[row]["mae"]["n"], ours[row]["sun_dw_mae"]["n"]
    return Figure(
        name=name,
        shows="MAE, RMSE, si-RMSE, Full, Sky, Sun (by pixel); angle; "
        f"{n} {shows}, {suns} with a sun",
        thesis=f"{numbers(of[:-1])}; {of[-1]:.1f}°",
        ours=f"{numbers(found[:-1])} ({numbers([by_pixel])}); {found[-1]:.1f}°"
        + (f"; worse: {', '.join(worse)}" if worse else ""),
        cells=tuple(cells),
        uncounted=uncounted,
        where=where,
        records=(record,),
    )


@dataclass(frozen=True, kw_only=True)
class Statement:
    """What the thesis says of a plot: its words, and the pairs (better, worse) that they mean."""

    words: str
    pairs: tuple[tuple[str, str], ...]


def each_before(better: Iterable[str], worse: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Every pair of the two; none of a row with itself."""
    others = list(worse)
    return tuple((b, w) for b in better for w in others if b != w)


def stated(
    name: str,
    shows: str,
    record: str,
    metric: str,
    statement: Statement,
    where: str,
    *,
    at: int,
    rows: Mapping[str, str],
    rises: bool = False,
    uncounted: str = "",
) -> Figure:
    """All of ``rows`` (name in the record: name shown), best first at one count.

    A cell is a pair of the statement, met where it holds at every count of the record. A row of a
    pair that was not measured is named, and the pair is then not met.
    """
    found = results(record)["rows"]
    there = [row for row in rows if row in found]
    sign = -1 if rises else 1

    def value(row: str, count: int) -> float:
        return found[row][f"{metric}_{count}"]["mean"]

    pattern = re.compile(rf"{metric}_(\d+)")
    counts = sorted(int(m[1]) for key in found[there[0]] if (m := pattern.fullmatch(key)))
    held: list[bool] = []
    here, elsewhere = [], 0
    for better, worse in statement.pairs:
        pair = better in found and worse in found
        broken = [c for c in counts if pair and sign * value(better, c) >= sign * value(worse, c)]
        held.append(pair and not broken)
        if at in broken:
            here.append(f"{rows[worse]} before {rows[better]}")
        elsewhere += bool(broken) and at not in broken
    missing = sorted({rows[row] for pair in statement.pairs for row in pair if row not in found})
    ordered = sorted(there, key=lambda row: sign * value(row, at))
    ours = ", ".join(f"{rows[row]} {value(row, at):.3f}" for row in ordered)
    ours += "; not measured: " + ", ".join(missing) if missing else ""
    ours += "; against it: " + "; ".join(here) if here else ""
    ours += f"; against it at other counts: {elsewhere} more pairs" if elsewhere else ""
    return Figure(
        name=name,
        shows=f"{shows}, at {at} (the verdict: at all of {', '.join(map(str, counts))})",
        thesis=statement.words,
        ours=ours,
        cells=tuple(held),
        uncounted=uncounted,
        where=where,
        records=(record,),
    )


def falls(values: Sequence[float]) -> bool:
    return all(later < earlier for earlier, later in pairwise(values))


def numbers(values: Iterable[float], digits: int = 2) -> str:
    return " ".join(f"{float(value):.{digits}f}".lstrip("0") for value in values)
