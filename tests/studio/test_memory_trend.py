"""The trend of memory that ``tools.load_studio`` records."""

import os
import subprocess
import sys
import time

import pytest

from tools.load import memory
from tools.load.memory import Sample, Sampler, trend

SLOPE, EVERY_MIN = 3.0, 1 / 12


def _lives(*levels: float, minutes: float = 10, ripple: float = 0.0) -> list[Sample]:
    """Processes one after the other, which load for half a minute and then grow by a line."""
    samples = []
    for process, level in enumerate(levels):
        for step in range(round(minutes / EVERY_MIN)):
            age = step * EVERY_MIN
            grown = level + SLOPE * age + ripple * (-1) ** step if age > 0.5 else 0.1 * level
            minute = process * minutes + age
            samples.append(Sample(minute=minute, process=process, megabytes=grown))
    return samples


def test_the_slope_is_that_within_each_process() -> None:
    """Neither the loading of a process nor another's level is a trend."""
    told = trend(_lives(100, 900, 300, 700))
    assert told["processes"] == 4
    assert told["slope_mb_per_min"] == pytest.approx(SLOPE)
    assert told["noise_mb"] == pytest.approx(0, abs=1e-9)
    assert told["last_mb"] == pytest.approx(700 + SLOPE * (10 - EVERY_MIN))


def test_the_noise_is_that_about_the_line() -> None:
    told = trend(_lives(500, minutes=20, ripple=8))
    assert told["noise_mb"] == pytest.approx(8, rel=0.02)
    assert told["slope_mb_per_min"] == pytest.approx(SLOPE, abs=told["slope_error_mb_per_min"])
    # of a line through n samples over T minutes: noise / (T sqrt(n / 12))
    assert told["slope_error_mb_per_min"] == pytest.approx(8 / (10 * 10**0.5), rel=0.03)


def test_only_the_second_half_counts() -> None:
    early = [Sample(minute=m / 10, process=7, megabytes=50.0 * m) for m in range(100)]
    late = [Sample(minute=10 + m / 10, process=7, megabytes=5000.0) for m in range(101)]
    assert trend(early + late)["slope_mb_per_min"] == pytest.approx(0, abs=1e-9)


def test_too_few_samples_have_no_slope() -> None:
    assert trend([]) == {"samples": 0}
    assert "slope_mb_per_min" not in trend(_lives(10, minutes=1.2)[:13])


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="reads /proc")
def test_the_memory_of_a_process_is_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "EVERY_S", 0.05)
    program = "held = bytearray(b'x') * 200_000_000; input()"
    with subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE) as process:
        sampler = Sampler(process.pid)
        begun = time.monotonic()
        while not any(one.megabytes > 200 for one in sampler.samples["server"]):
            assert time.monotonic() - begun < 60
            time.sleep(0.01)
        sampler.end()
        process.kill()
    assert max(one.megabytes for one in sampler.samples["server"]) < 240
    assert sampler.samples["jobs"] == []  # it has no workers
