"""Write the table of the thesis' figures into ``docs/figures.md``, between its two marks.

    python -m tools.build_figures

Numbers are read from ``benchmarks/results``; the thesis' own are those that it prints in its tables
and captions (of its plots, which have no numbers, what its text says of them). A record whose code
changed since, or whose commit is not in this repository's history, is marked in each of its rows.
"""

from collections.abc import Callable
from pathlib import Path

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from tools import records
from tools.figures.compared import Figure
from tools.figures.light import faces, sparse_codes
from tools.figures.probes import partitions_probe, voxel_probe

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "figures.md"
BEGIN, END = "<!-- written by tools/build_figures.py: -->", "<!-- until here -->"
Mark = Callable[[str], str]  # of a record's name: what the page says of its age


def main() -> None:
    if not records.has_history():
        raise InputError("the ages of records need a clone with all commits: git fetch --unshallow")
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(BEGIN)
    _, tail = rest.split(END)
    with atomic_path(PAGE) as temporary:
        temporary.write_text(f"{head}{BEGIN}\n\n{table()}\n{END}{tail}", encoding="utf-8")
    print(PAGE)


def mark_of(name: str) -> str:
    return records.age(records.results(name)).mark


def chapters() -> dict[str, list[Figure]]:
    """All figures."""
    return {
        "Chapter 3: the voxel probe": voxel_probe(),
        "Chapter 4: the partitions probe": partitions_probe(),
        "Chapter 5 and appendix B: faces to outdoor light": faces(),
        "Chapter 6 and appendix C: sparse codes": sparse_codes(),
    }


def table(mark: Mark = mark_of) -> str:
    """All figures by chapter, and how many of the thesis' statements are met."""
    every = chapters()
    lines = [counted([figure for figures in every.values() for figure in figures])]
    for title, figures in every.items():
        lines += ["", f"### {title}", ""]
        lines += ["| | shows | thesis | skylight | met | from |", "|---|---|---|---|---|---|"]
        lines += [
            f"| {f.name} | {f.shows} | {f.thesis} | {f.ours} | {f.verdict} | {_origin(f, mark)} |"
            for f in figures
        ]
    return "\n".join(lines) + "\n"


def counted(figures: list[Figure]) -> str:
    """Rows by the thesis' own statements, and apart from them those by other yardsticks."""
    told = [figure for figure in figures if figure.cells]
    own = [figure for figure in told if not figure.uncounted]
    others = [figure for figure in told if figure.uncounted]
    return (
        f"Of the {len(own)} rows that state numbers or an ordering of the thesis, each counted "
        f"once, {_met(own)} are met in every cell; of their {_cells(own)} cells (numbers, and "
        f"pairs of an ordering) {_cells(own, met=True)}. Verdicts in brackets do not count, for "
        f"the reason that stands there; {_met(others)} of {len(others)} are yes. The other "
        f"{len(figures) - len(told)} rows compare nothing. Appendix A lists contributors."
    )


def _met(figures: list[Figure]) -> int:
    return sum(bool(figure.met) for figure in figures)


def _cells(figures: list[Figure], *, met: bool = False) -> int:
    return sum(cell or not met for figure in figures for cell in figure.cells)


def _origin(figure: Figure, mark: Mark) -> str:
    told = [f"{name} at {_commit(name)}{_said(mark(name))}" for name in figure.records]
    return "; ".join([figure.where, *told])


def _commit(name: str) -> str:
    return records.commit_of(records.results(name))


def _said(mark: str) -> str:
    return f", {mark}" if mark else ""


if __name__ == "__main__":
    main()
