"""Commands killed at random moments, resumed, and compared with an undisturbed run.

A scenario is a module of ``tests.faults.scenarios``: ``command(folder)`` tells what to run,
``result(folder)`` what must not depend on kills, and ``whole(found, expected)``, where there is
one, whether what stands there after a kill is fit to be seen.
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
    """``kills`` that met the command at work, over ``runs`` folders; what differed, by name."""

    kills: int
    runs: int
    undisturbed_s: float
    differences: tuple[str, ...]


def kill_runs(scenario: ModuleType, folder: Path, *, kills: int, seed: int) -> Outcome:
    """Kill the whole process group of a command ``kills`` times, at uniformly drawn moments.

    Each folder is gone on with until its command ends; where that is before enough kills, another
    folder is begun. Kills come within the time that the quickest undisturbed run took.
    """
    draw = random.Random(seed)
    started = time.monotonic()
    if failure := attempt(scenario.command(folder / "undisturbed"), PATIENCE_S):
        raise RuntimeError(failure)
    duration = time.monotonic() - started
    expected = scenario.result(folder / "undisturbed")
    if not expected:
        raise ValueError(f"{scenario.__name__}: the undisturbed run has no result")
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
                if hasattr(scenario, "whole") and not scenario.whole(
                    scenario.result(place), expected
                ):
                    differences.append(f"{run}, after kill {done}: not whole")
        if failure == KILLED:  # that was the last one
            failure = attempt(command, PATIENCE_S)
        if failure:
            differences.append(f"{run}: {failure}")
            continue
        if done == before:  # the machine has become quicker, or its load less
            duration = min(duration, time.monotonic() - begun)
        found = scenario.result(place)
        differences += [
            f"{run}: {name}"
            for name in sorted(expected.keys() | found.keys())
            if expected.get(name) != found.get(name)
        ]
    return Outcome(kills=done, runs=runs, undisturbed_s=duration, differences=tuple(differences))


def attempt(command: list[str], seconds: float) -> str:
    """Empty where the command ended well; ``KILLED`` after that time; else how it failed."""
    process = subprocess.Popen(
        command,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _, told = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        _, told = process.communicate()
        if process.returncode == -signal.SIGKILL:
            return KILLED
    return f"ended with {process.returncode}: {told.strip()}" if process.returncode else ""
