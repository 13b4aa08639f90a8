"""The tables of the studio's runs under load in ``docs/hardening.md``.

    python -m tools.load.table

A column for each record ``benchmarks/results/studio-load*.json``; no number is written by hand.
"""

from pathlib import Path
from typing import Any

from skylight.io._atomic import atomic_path
from skylight.io._bounded import json_content

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "hardening.md"
Record = dict[str, Any]
_BEGIN, _END = "<!-- written by tools/load/table.py: -->\n", "<!-- until here -->"
_KINDS = ("estimate", "code", "voxel", "partitions")
_PROCESSES = {
    "server": "server",
    "jobs": "worker of jobs",
    "reader": "worker that reads uploads",
}


def main() -> None:
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(_BEGIN)
    _, _, after = rest.partition(_END)
    with atomic_path(PAGE) as temporary:
        temporary.write_text(before + section(records()) + after, encoding="utf-8")
    print(PAGE)


def records() -> list[Record]:
    """Of all runs, in the order of their files' names."""
    found = sorted(ROOT.glob("benchmarks/results/studio-load*.json"))
    return [json_content(path) for path in found]


def section(runs: list[Record]) -> str:
    """The commands and the tables, between the marks that tell where they are in the page."""
    columns = [_facts(run) for run in runs]
    rows = [[name, *(column[name] for column in columns)] for name in columns[0]]
    lines = [
        *(
            f"{number}. `{run['command']}`, commit {run['commit']}, {run['date']}, {run['machine']}"
            for number, run in enumerate(runs, 1)
        ),
        "",
        *_table(["run", *map(str, range(1, len(runs) + 1))], rows),
        "",
        *_table(
            ["memory, 10^6 bytes", "run", "processes", "most", "at the end", "a minute", "noise"],
            [
                [title, str(number), *_memory(run["memory"][name])]
                for name, title in _PROCESSES.items()
                for number, run in enumerate(runs, 1)
            ],
        ),
    ]
    return _BEGIN + "\n".join(lines) + "\n" + _END


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows)]


def _facts(run: Record) -> dict[str, str]:
    def count(*names: str) -> str:
        return str(sum(run["counts"].get(name, 0) for name in names))

    return {
        "pages at once": str(run["browsers"]),
        "minutes": f"{run['minutes']:g}",
        "cores": str(run["cores"]),
        "pages opened": count("pages"),
        "deeds": count("deeds"),
        "uploads taken": count("uploads"),
        "uploads refused for the time being (429)": count("uploads_refused"),
        "uploads of a byte a second, refused (408)": count("slow_uploads_answered_408"),
        "jobs taken": count(*(f"jobs_{kind}" for kind in _KINDS)),
        "of these done, with all files": count("jobs_done"),
        "cancelled": count("jobs_cancelled"),
        "left by their page": count("jobs_left"),
        "**lost**": str(run["jobs_lost"]),
        "jobs refused for the time being (429)": count("jobs_refused"),
        "jobs whose events nobody opened": count("jobs_never_watched"),
        "errors in the pages' consoles": str(run["console_errors"]),
        "other failures": str(run["failures"]),
        "most jobs before one that waits": str(run["most_jobs_before"]),
        "longest wait for a job to begin": f"{run['longest_wait_s']:.0f} s",
        "longest job, its wait included": f"{run['longest_job_s']:.0f} s",
        "longest time without an event": f"{run['longest_event_gap_s']:.1f} s",
        "longest time from leaving a job to its end": f"{run['longest_until_cancelled_s']:.1f} s",
    }


def _memory(trend: dict[str, float]) -> list[str]:
    slope, error = trend["slope_mb_per_min"], trend["slope_error_mb_per_min"]
    return [
        f"{trend['processes']}",
        f"{trend['peak_mb']:.0f}",
        f"{trend['last_mb']:.0f}",
        f"{slope:.2f} +- {error:.2f}",
        f"{trend['noise_mb']:.1f}",
    ]


if __name__ == "__main__":
    main()
