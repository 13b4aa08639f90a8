"""The same estimate on one thread and on two, and two at once in one process.

docs/hardening.md says what was measured for the other lights.
"""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from skimage.data import astronaut

import skylight
from skylight.inverse._result import Estimate

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TOLERANCE = {"sh9": 1e-6}


def digest(light: str, threads: int) -> dict:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "estimate_digest.py"), "--light", light],
        env={**os.environ, "OMP_NUM_THREADS": str(threads)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["threads"] == threads
    return told


def numbers(told: dict) -> torch.Tensor:
    kinds = [torch.tensor(told[name]).flatten() for name in ("sun_direction", "albedo", "radiance")]
    return torch.cat([kind / kind.abs().max() for kind in kinds])


@pytest.mark.parametrize("light", TOLERANCE)
def test_one_thread_and_two(light: str) -> None:
    one, two = (numbers(digest(light, threads)) for threads in (1, 2))
    assert float((one - two).abs().max()) <= TOLERANCE[light]


def test_two_at_once_do_not_disturb_each_other() -> None:
    """Two photographs of one size and two lights, so that nothing of one fits the other."""
    photos = [astronaut()[:256, left : left + 256].copy() for left in (100, 120)]

    def estimate(index: int) -> Estimate:
        return skylight.estimate(photos[index], light="sh9")

    alone = [estimate(index) for index in range(2)]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(estimate, range(2)))
    for ours, theirs in zip(together, alone, strict=True):
        assert torch.equal(ours.environment.radiance, theirs.environment.radiance)
        assert torch.equal(ours.albedo, theirs.albedo)
    assert not torch.equal(alone[0].environment.radiance, alone[1].environment.radiance)
