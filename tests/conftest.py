"""What every test may ask for."""

import gc
import os
from collections.abc import Generator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import torch

from tests import annotations  # before anything of the package
from tests.face_captures import MadeCaptures, make_captures

# Timings are for benchmarks, so no deadlines. On CI every run draws the same examples: a change
# is judged by what it changes, and chance finds its cases on people's machines.
hypothesis.settings.register_profile(
    "skylight", deadline=None, derandomize="CI" in os.environ, print_blob=True
)
hypothesis.settings.load_profile("skylight")


_left_out = pytest.StashKey[int]()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Imports make millions of objects that stay, so no search for cycles among them pays.

    Tests import more, and make few cycles: searching seldom saves a tenth of their time.
    """
    from skylight.work._memory import collect_seldom  # not before tests.annotations

    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        collect_seldom()
        gc.enable()


def pytest_unconfigure() -> None:
    """What is frozen would be reported as leaked by OpenImageIO's binding."""
    gc.unfreeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    annotations.calls.clear()


def pytest_deselected(items: list[pytest.Item]) -> None:
    config = items[0].config
    slow = sum(item.get_closest_marker("slow") is not None for item in items)
    config.stash[_left_out] = config.stash.get(_left_out, 0) + slow
    if hasattr(config, "workeroutput"):  # a worker of pytest-xdist, which passes nothing on itself
        config.workeroutput["left_out"] = config.stash[_left_out]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    node.config.stash[_left_out] = getattr(node, "workeroutput", {}).get("left_out", 0)


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    if count := config.stash.get(_left_out, 0):
        terminalreporter.write_line(f"{count} slow tests were left out; make night runs them")


@pytest.fixture(scope="session", params=["cpu", "cuda"])
def device(request: pytest.FixtureRequest) -> torch.device:
    """Each device that code has to run on; CUDA is skipped where there is none."""
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    return torch.device(request.param)


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


@pytest.fixture(scope="session")
def estimated_portrait(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """(A photograph, the folder of its estimate): the one run of the command that most tests need.

    Tests that write take a copy of the folder.
    """
    from tests.estimated import estimated

    return estimated(tmp_path_factory.mktemp("estimated"))


@pytest.fixture
def probe(tmp_path: Path) -> Path:
    """A map of 16 rows with a sun of 500 in row 4, column 20."""
    from skylight.io._files import write_environment_map
    from skylight.sphere._envmap import EnvironmentMap

    radiance = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    radiance[4, 20] = 500.0
    write_environment_map(tmp_path / "probe.exr", EnvironmentMap(radiance=radiance))
    return tmp_path / "probe.exr"
