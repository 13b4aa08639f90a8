"""Fuzz all readers and the studio for long, guided by coverage (atheris).

    python tools/fuzz.py                          5 minutes a target
    python tools/fuzz.py exr mesh --seconds 3600

Writes ``benchmarks/results/fuzz.json``; what was found goes to ``--findings`` as files, and the
exit code is 1. See one again: python -m tests.fuzz TARGET --again FILE.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from tests.fuzz.__main__ import MEMORY_MB, TIMEOUT_S  # noqa: E402
from tests.fuzz.targets import NAMES  # noqa: E402
from tools.measured import write_measured  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", default=NAMES, help=", ".join(NAMES))
    parser.add_argument("--seconds", type=int, default=300, help="for each target")
    parser.add_argument("--findings", type=Path, default=ROOT / "out" / "fuzz")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "fuzz.json")
    options = parser.parse_args()
    options.findings.mkdir(parents=True, exist_ok=True)
    begun = time.time()
    found = {name: fuzz(name, options.seconds, options.findings) for name in options.targets}
    write_measured(
        options.out,
        name="fuzz",
        what="Coverage-guided fuzzing of what reads files, and of the studio: inputs, and findings "
        "(other errors than a line that says what is wrong, hangs, too much memory)",
        command=f"python tools/fuzz.py {' '.join(options.targets)} --seconds {options.seconds}",
        begun=begun,
        facts={
            "timeout_s": TIMEOUT_S,
            "memory_mb": MEMORY_MB,
            "inputs": sum(each["inputs"] for each in found.values()),
            "findings": sum(each["findings"] for each in found.values()),
            "targets": found,
        },
    )
    sys.exit(any(each["findings"] for each in found.values()))


def fuzz(name: str, seconds: int, findings: Path) -> dict[str, int]:
    """Inputs, findings, the largest memory and the seconds of one target."""
    log = findings / f"{name}.log"
    command = [sys.executable, "-m", "tests.fuzz", name, "--seconds", str(seconds)]
    started = time.monotonic()
    with log.open("w") as stream:
        done = subprocess.run(
            [*command, "--findings", str(findings)],
            stdout=stream,
            stderr=stream,
            cwd=ROOT,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
    told = log.read_text(errors="replace")

    def stat(pattern: str) -> int:
        numbers = re.findall(pattern, told)
        return int(numbers[-1]) if numbers else 0

    report = {
        "inputs": stat(r"stat::number_of_executed_units:\s*(\d+)") or stat(r"(?m)^#(\d+)"),
        "findings": int(done.returncode != 0),
        "peak_mb": stat(r"stat::peak_rss_mb:\s*(\d+)"),
        "seconds": round(time.monotonic() - started),
    }
    print(name, report, f"see {log}" if done.returncode else "", flush=True)
    return report


if __name__ == "__main__":
    main()
