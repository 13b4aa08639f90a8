"""The table of ``benchmarks/results/studio-load.json`` in ``docs/hardening.md``.

    python -m tools.load.table

No number of it is written by hand.
"""

from pathlib import Path
from typing import Any

from skylight.io.atomic import atomic_path
from skylight.io.bounded import json_content

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "benchmarks" / "results" / "studio-load.json"
PAGE = ROOT / "docs" / "hardening.md"
_BEGIN, _END = "<!-- written by tools/load/table.py: -->\n", "<!-- until here -->"
_PROCESSES = {
    "server": "server",
    "jobs": "worker of jobs",
    "reader": "worker that reads uploads",
}


def main() -> None:
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(_BEGIN)
    _, _, after = rest.partition(_END)
    with atomic_path(PAGE) as temporary:
        temporary.write_text(before + section(json_content(RECORD)) + after, encoding="utf-8")
    print(PAGE)


def section(record: dict[str, Any]) -> str:
    """The command and both tables, between the marks that tell where they are in the page."""
    counts = record["counts"]

    def count(name: str) -> str:
        return str(counts.get(name, 0))

    jobs = sum(number for name, number in counts.items() if name in _KINDS)
    facts = [
        ("browsers, minutes, cores", _listed(record, "browsers", "minutes", "cores")),
        ("pages, deeds", f"{count('pages')}, {count('deeds')}"),
        ("uploads taken, refused for the time being (429)", _two(counts, "uploads")),
        ("jobs taken, refused for the time being (429)", f"{jobs}, {count('jobs_refused')}"),
        (
            "of these done with all files, cancelled, left by their page",
            ", ".join(count(f"jobs_{how}") for how in ("done", "cancelled", "left")),
        ),
        ("jobs whose events nobody opened", count("jobs_never_watched")),
        ("uploads of a byte a second, refused (408)", count("slow_uploads_answered_408")),
        ("jobs lost", str(record["jobs_lost"])),
        ("errors in consoles, other failures", _listed(record, "console_errors", "failures")),
        ("most jobs before one that waits", str(record["most_jobs_before"])),
        ("longest wait for a job to begin", f"{record['longest_wait_s']:.0f} s"),
        ("longest job, its wait included", f"{record['longest_job_s']:.0f} s"),
        ("longest time without an event", f"{record['longest_event_gap_s']:.1f} s"),
        (
            "longest time from leaving to the job's being cancelled",
            f"{record['longest_until_cancelled_s']:.1f} s",
        ),
    ]
    lines = [
        f"`{record['command']}`, commit {record['commit']}, {record['date']}, {record['machine']}:",
        "",
        "| | |",
        "|---|---|",
        *(f"| {name} | {value} |" for name, value in facts),
        "",
        "| memory (10^6 bytes) | processes | most | at the end | MB a minute | noise, MB |",
        "|---|---|---|---|---|---|",
        *(_memory(title, record["memory"][name]) for name, title in _PROCESSES.items()),
    ]
    return _BEGIN + "\n".join(lines) + "\n" + _END


_KINDS = ("jobs_estimate", "jobs_code", "jobs_voxel", "jobs_partitions")


def _listed(record: dict[str, Any], *names: str) -> str:
    return ", ".join(f"{record[name]:g}" for name in names)


def _two(counts: dict[str, int], what: str) -> str:
    return f"{counts.get(what, 0)}, {counts.get(f'{what}_refused', 0)}"


def _memory(title: str, trend: dict[str, float]) -> str:
    slope, noise = "too few samples", ""
    if "slope_mb_per_min" in trend:
        slope = f"{trend['slope_mb_per_min']:.2f} +- {trend['slope_error_mb_per_min']:.2f}"
        noise = f"{trend['noise_mb']:.1f}"
    most, last = trend["peak_mb"], trend["last_mb"]
    return f"| {title} | {trend['processes']} | {most:.0f} | {last:.0f} | {slope} | {noise} |"


if __name__ == "__main__":
    main()
