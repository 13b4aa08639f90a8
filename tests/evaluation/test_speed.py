"""Times of an estimate, with estimates that take none."""

import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from PIL import Image

from skylight.evaluation import _speed as speed
from skylight.evaluation._speed import Speed


def test_processor_time_is_that_of_the_estimate_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.new("RGB", (40, 40)).save(tmp_path / "a.png")

    def estimate(photo: Path, **_: object) -> SimpleNamespace:
        end = time.process_time() + 0.1
        while time.process_time() < end:
            pass
        return SimpleNamespace(seconds={"face": 0.1})

    monkeypatch.setattr(speed, "_estimated_once", lambda *_: None)
    monkeypatch.setattr(speed, "estimate_photo", estimate)
    monkeypatch.setattr(speed, "write_results", lambda folder, result: time.sleep(0.1))
    found = Speed(data=tmp_path, runs=()).measure("a.png", tmp_path).metrics
    assert 0.1 <= found["all"]["cpu_seconds"] <= found["all"]["seconds"] - 0.05
    assert found["face"] == {"seconds": 0.1}
    assert found["report and files"]["seconds"] >= 0.1
