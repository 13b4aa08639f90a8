"""Every target reads or refuses a fixed number of mutated files; ``make fuzz`` goes on for long."""

import json
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from tests.fuzz.__main__ import one
from tests.fuzz.mutate import mutated
from tests.fuzz.targets import NAMES

ROOT = Path(__file__).parents[2]
FEWER = {
    "mesh": 150,
    "records": 150,
    "estimate": 150,
    "maps": 150,
    "studio": 100,
    "raw": 100,
    "bundle": 100,
}
INPUTS = dict.fromkeys(NAMES, 300) | FEWER
TEXTS = ("code", "records", "mesh", "vox", "onnx", "notes", "blender", "mp4")


@cache
def reports(count: int) -> dict[str, dict]:
    """Of all targets with as many inputs, in a process of their own, as a finding may end it."""
    names = [name for name in NAMES if INPUTS[name] == count]
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", *names, "--inputs", str(count)],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return {line["target"]: line for line in map(json.loads, done.stdout.splitlines())}


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_mutated_files_are_read_or_refused(name: str) -> None:
    told = reports(INPUTS[name])[name]
    assert told["inputs"] == INPUTS[name]
    assert told["read"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", TEXTS)
def test_any_bytes_are_read_or_refused(name: str) -> None:
    target = import_module(f"tests.fuzz.targets.{name}")
    beginnings = sorted({seed[:20] for seed in target.seeds()})

    @settings(max_examples=40)
    @given(
        st.sampled_from([b"", *beginnings]),
        st.one_of(st.binary(max_size=200), st.text().map(str.encode)),
    )
    def check(beginning: bytes, rest: bytes) -> None:
        one(target.read, beginning + rest)

    check()


def test_mutations_repeat() -> None:
    seeds = [b"one seed", b"another one"]
    made = list(mutated(seeds, 200, 7))
    assert made == list(mutated(seeds, 200, 7))
    assert made[:2] == seeds
    assert len(set(made)) > 150
