"""Small files that claim very much are refused in one line, at once, and without the memory."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.bombs import BOMBS

GROWN_MB, SECONDS = 200, 30  # libraries that are loaded on the way, and a busy machine


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list]:
    folder = tmp_path_factory.mktemp("bombs")
    done = subprocess.run(
        [sys.executable, "-m", "tests.faults.bombs", str(folder)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", BOMBS)
def test_it_is_refused_before_memory_is_taken(told: dict[str, list], name: str) -> None:
    kind, line, grown_mb, seconds = told[name]
    assert kind in ("InputError", "AssetError"), line
    assert name in line
    assert "\n" not in line
    assert "item named" not in line  # for the reason that it is here for
    assert grown_mb < GROWN_MB
    assert seconds < SECONDS
