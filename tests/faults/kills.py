"""Commands killed at random times, resumed, and compared with an uninterrupted run.

A scenario is a module of ``tests.faults.scenarios``: ``command(folder)`` is the command line,
``result(folder)`` the output that must not depend on kills, and ``is_consistent(found, expected)``,
if defined, whether the output right after a kill has no partial files.
"""

import os
import random
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

PATIENCE_S = 900
KILLED = "killed"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """``kills`` that interrupted the command, over ``runs`` folders; names of what differed."""

    kills: int
    runs: int
    undisturbed_s: float
    differences: tuple[str, ...]


def kill_runs(scenario: ModuleType, folder: Path, *, kills: int, seed: int) -> Outcome:
    """Kill the process group of a command ``kills`` times, at uniformly distributed times.

    The command is resumed in its folder until it finishes; if that is before enough kills, it is
    started in another folder. Kills come within the time of the fastest uninterrupted run.
    """
    draw = random.Random(seed)
    started = time.monotonic()
    if failure := attempt(scenario.command(folder / "uninterrupted"), PATIENCE_S):
        raise RuntimeError(failure)
    duration = time.monotonic() - started
    expected = scenario.result(folder / "uninterrupted")
    if not expected:
        raise ValueError(f"{scenario.__name__}: the uninterrupted run has no result")
    done = runs = 0
    differences: list[str] = []
    while done < kills:
        place, run = folder / f"run{runs}", f"run {runs}"
        runs += 1
        command = scenario.command(place)
        begun, before = time.monotonic(), done
        failure = KILLED
        while done < kills and failure == KILLED:
            failure = attempt(command, draw.uniform(0, duration))
            if failure == KILLED:
                done += 1
                if hasattr(scenario, "is_consistent") and not scenario.is_consistent(
                    scenario.result(place), expected
                ):
                    differences.append(f"{run}, after kill {done}: inconsistent")
        if failure == KILLED:  # that was the last one
            failure = attempt(command, PATIENCE_S)
        if failure:
            differences.append(f"{run}: {failure}")
            continue
        if done == before:  # the machine has become faster, or less loaded
            duration = min(duration, time.monotonic() - begun)
        found = scenario.result(place)
        differences += [
            f"{run}: {name}"
            for name in sorted(expected.keys() | found.keys())
            if expected.get(name) != found.get(name)
        ]
    return Outcome(kills=done, runs=runs, undisturbed_s=duration, differences=tuple(differences))


def attempt(command: list[str], seconds: float) -> str:
    """Empty on success; ``KILLED`` if it was killed after that time; else how it failed."""
    process = subprocess.Popen(
        command,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _, stderr = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        _, stderr = process.communicate()
        if process.returncode == -signal.SIGKILL:
            return KILLED
    return f"ended with {process.returncode}: {stderr.strip()}" if process.returncode else ""
