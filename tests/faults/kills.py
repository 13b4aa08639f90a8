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
    _finish(scenario.command(folder / "undisturbed"))
    duration = time.monotonic() - started
    expected = scenario.result(folder / "undisturbed")
    if not expected:
        raise ValueError(f"{scenario.__name__}: the undisturbed run has no result")
    done = runs = 0
    differences: list[str] = []
    while done < kills:
        place = folder / f"run{runs}"
        runs += 1
        command = scenario.command(place)
        begun, before = time.monotonic(), done
        while done < kills and not ended(command, draw.uniform(0, duration)):
            done += 1
            if hasattr(scenario, "whole") and not scenario.whole(scenario.result(place), expected):
                differences.append(f"run {runs}, after kill {done}: not whole")
        if done == before:  # the machine has become quicker, or its load less
            duration = min(duration, time.monotonic() - begun)
        try:
            _finish(scenario.command(place))
        except RuntimeError as error:
            differences.append(f"run {runs}: {error}")
            continue
        found = scenario.result(place)
        differences += [
            f"run {runs}: {name}"
            for name in sorted(expected.keys() | found.keys())
            if expected.get(name) != found.get(name)
        ]
    return Outcome(kills=done, runs=runs, undisturbed_s=duration, differences=tuple(differences))


def ended(command: list[str], seconds: float) -> bool:
    """Whether the command ended within that time, well or not; it is killed otherwise."""
    process = _start(command)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        return process.wait() != -signal.SIGKILL
    return True


def _finish(command: list[str]) -> None:
    process = _start(command, subprocess.PIPE)
    try:
        _, told = process.communicate(timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)}: ended with {process.returncode}: {told}")


def _start(command: list[str], errors: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=errors, text=True
    )
