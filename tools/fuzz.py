"""Fuzz all readers and the studio for long, guided by coverage (atheris).

    python tools/fuzz.py                                    5 minutes a target
    python tools/fuzz.py exr mesh --seconds 3600
    python tools/fuzz.py --inputs 10000000 --seconds 120    rounds of 2 minutes a target, to the sum

Writes ``benchmarks/results/fuzz.json``; what was found goes to ``--findings`` as files, and the
exit code is 1. See one again: python -m tests.fuzz TARGET --again FILE.

All targets have equal times, so the slow ones take fewer inputs. ``--findings`` also keeps their
corpora, which the next round begins with, and the figures of each round: the same command goes on
where it was stopped. Inputs of a corpus that are only read again do not count.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from skylight.evaluation._main import commit  # noqa: E402
from skylight.io._bounded import json_content, write_json  # noqa: E402
from tests.fuzz.__main__ import MEMORY_MB, TIMEOUT_S  # noqa: E402
from tests.fuzz.targets import NAMES  # noqa: E402
from tools.measured import write_measured  # noqa: E402

DONE = "rounds.json"
_IN_MEMORY = Path("/dev/shm")  # where files cost less than what reads them
Round = dict[str, int]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", default=NAMES, help=", ".join(NAMES))
    parser.add_argument("--seconds", type=int, default=300, help="for each target, in a round")
    parser.add_argument("--inputs", type=int, default=1, help="rounds go on to so many in all")
    parser.add_argument("--workers", type=int, default=1, help="targets at once")
    parser.add_argument("--findings", type=Path, default=ROOT / "out" / "fuzz")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "fuzz.json")
    options = parser.parse_args()
    options.findings.mkdir(parents=True, exist_ok=True)
    rounds = Rounds(options.findings)
    number = 0
    while number == 0 or rounds.inputs < options.inputs:
        missing = [name for name in options.targets if not rounds.has(name, number)]
        before = rounds.inputs
        with ThreadPoolExecutor(options.workers) as pool:
            running = {
                pool.submit(fuzz, name, options.seconds, number, options.findings): name
                for name in missing
            }
            for done in as_completed(running):
                rounds.add(running[done], number, done.result())
        if missing and rounds.inputs == before:
            sys.exit(f"no target took an input: see the logs in {options.findings}")
        number += 1
    found = rounds.summed(options.targets)
    write_measured(
        options.out,
        name="fuzz",
        what="Coverage-guided fuzzing of what reads files, and of the studio: inputs, and findings "
        "(other errors than a line that says what is wrong, hangs, too much memory)",
        command=f"python tools/fuzz.py {' '.join(options.targets)} --seconds {options.seconds}"
        f" --inputs {options.inputs} --workers {options.workers}",
        begun=time.time() - sum(each["seconds"] for each in found.values()),
        facts={
            "timeout_s": TIMEOUT_S,
            "memory_mb": MEMORY_MB,
            "inputs": sum(each["inputs"] for each in found.values()),
            "findings": sum(each["findings"] for each in found.values()),
            "targets": found,
        },
    )
    sys.exit(any(each["findings"] for each in found.values()))


class Rounds:
    """The figures of every target's rounds, kept in a folder, all of the same commit."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / DONE
        kept = json_content(self._file) if self._file.exists() else {"commit": commit()}
        if kept["commit"] != commit():
            sys.exit(f"{self._file}: of commit {kept['commit']}; delete it to begin anew")
        self._kept: dict[str, dict[str, Round]] = kept.setdefault("targets", {})
        self._all = kept

    @property
    def inputs(self) -> int:
        return sum(one["inputs"] for target in self._kept.values() for one in target.values())

    def has(self, name: str, number: int) -> bool:
        return str(number) in self._kept.get(name, {})

    def add(self, name: str, number: int, done: Round) -> None:
        """Keep what came of a target's round."""
        self._kept.setdefault(name, {})[str(number)] = done
        write_json(self._file, self._all)
        print(f"{self.inputs} inputs; {name}, round {number}: {done}", flush=True)

    def summed(self, targets: Iterable[str]) -> dict[str, Round]:
        """Of all rounds together."""
        found = {}
        for name in targets:
            rounds = list(self._kept[name].values())
            found[name] = {
                key: sum(one[key] for one in rounds) for key in ("inputs", "findings", "seconds")
            } | {"peak_mb": max(one["peak_mb"] for one in rounds)}
        return found


def fuzz(name: str, seconds: int, number: int, findings: Path) -> Round:
    """Inputs, findings, the largest memory and the seconds of one target's round."""
    log = findings / f"{name}.log"
    command = [sys.executable, "-m", "tests.fuzz", name, "--seconds", str(seconds)]
    command += ["--seed", str(number), "--findings", str(findings.resolve())]
    memory = {"TMPDIR": str(_IN_MEMORY)} if _IN_MEMORY.is_dir() else {}
    started = time.monotonic()
    with log.open("w") as stream:
        done = subprocess.run(
            command,
            stdout=stream,
            stderr=stream,
            cwd=ROOT,
            env={**os.environ, **memory, "OMP_NUM_THREADS": "1"},
        )
    told = log.read_text(errors="replace")

    def stat(pattern: str) -> int:
        numbers = re.findall(pattern, told)
        return int(numbers[-1]) if numbers else 0

    ran = stat(r"stat::number_of_executed_units:\s*(\d+)") or stat(r"(?m)^#(\d+)")
    hung = re.findall(r"Test unit written to (\S+-timeout-\w+)", told)
    stood_still = bool(hung) and is_read_in_time(name, hung[-1])
    return {
        "inputs": max(0, ran - stat(r"(?m)^#(\d+)\s+INITED")),
        "findings": int(done.returncode != 0 and not stood_still),
        "peak_mb": stat(r"stat::peak_rss_mb:\s*(\d+)"),
        "seconds": round(time.monotonic() - started),
    }


def is_read_in_time(name: str, finding: str) -> bool:
    """Whether what took too long does not do so again: then the machine or the process stood still.

    Also False where another error comes of it.
    """
    command = [sys.executable, "-m", "tests.fuzz", name, "--again", finding]
    try:
        return subprocess.run(command, cwd=ROOT, timeout=30 * TIMEOUT_S).returncode == 0
    except subprocess.TimeoutExpired:
        return False


if __name__ == "__main__":
    main()
