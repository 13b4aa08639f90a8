"""What every test may ask for."""

import os
from pathlib import Path

import hypothesis
import pytest

from tests.face_captures import MadeCaptures, make_captures

# Timings are for benchmarks, so no deadlines. On CI every run draws the same examples: a change
# is judged by what it changes, and chance finds its cases on people's machines.
hypothesis.settings.register_profile(
    "skylight", deadline=None, derandomize="CI" in os.environ, print_blob=True
)
hypothesis.settings.load_profile("skylight")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of collected data, for tests that want real files; they skip without it."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SKYLIGHT_TEST_DATA", beside))
    if not folder.is_dir():
        pytest.skip("no collected data: set SKYLIGHT_TEST_DATA to its folder")
    return folder


@pytest.fixture(scope="session")
def face_captures(tmp_path_factory: pytest.TempPathFactory) -> MadeCaptures:
    """Captures of a rendered person; tests that write take a copy of the folder."""
    return make_captures(tmp_path_factory.mktemp("captures") / "faces")
