"""Processes that the extension runs: what it hears from them, and how they end."""

import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from blender.world_from_portrait import run as run_module
from blender.world_from_portrait.commands import (
    COMPATIBLE,
    KEYS,
    SIZES_DEG,
    USUAL_DEG,
    USUAL_STRENGTH,
    check_version,
    estimate_steps,
    find_skylight,
    relight_steps,
    relit_picture,
)
from blender.world_from_portrait.run import Failure, Run, Step, parse_progress

LINE = '{"stage": "tracing light", "share": 0.25}'


def python(program: str, *, stage: str = "starting") -> Step:
    return Step(stage, [sys.executable, "-c", program])


def ended(run: Run, patience_s: float = 20.0) -> str:
    until = time.monotonic() + patience_s
    while run.poll() == "running":
        assert time.monotonic() < until, run.stage
        time.sleep(0.01)
    return run.state


def heard(run: Run, stage: str, patience_s: float = 20.0) -> None:
    until = time.monotonic() + patience_s
    while run.stage != stage:
        assert run.poll() == "running", (run.state, run.error)
        assert time.monotonic() < until, run.stage
        time.sleep(0.01)


def test_steps_follow_each_other_and_progress_is_heard(tmp_path: Path) -> None:
    first = f"import sys, time; print({LINE!r}, file=sys.stderr, flush=True); sys.stdin.read()"
    waits = f"import pathlib, time\nwhile not pathlib.Path({str(tmp_path / 'go')!r}).exists():"
    second = f"import sys; print({LINE!r}, file=sys.stderr, flush=True)\n{waits} time.sleep(0.01)"
    run = Run([python(first), python(second, stage="exporting")])
    assert run.stage == "starting"
    heard(run, "exporting")
    heard(run, "tracing light")
    assert run.share == 0.25
    (tmp_path / "go").touch()
    assert ended(run) == "done"


@pytest.mark.parametrize(
    ("line", "told"),
    [
        (LINE, ("tracing light", 0.25)),
        ('{"stage": "a", "share": 1}\n', ("a", 1.0)),
        ("skylight: take care: grey picture", None),
        ('{"stage": "a", "share": 1.5}', None),
        ('{"stage": 3, "share": 0.5}', None),
        ('{"stage": "a", "share": null}', None),
        ('{"stage": "a"', None),
        pytest.param('{"stage": "a", "share": ' + "9" * 400 + "}", None, id="beyond float64"),
        pytest.param('{"stage": ' + "[" * 10**5, None, id="nested"),
        ("{}", None),
    ],
)
def test_only_progress_is_taken_for_progress(line: str, told: tuple[str, float] | None) -> None:
    assert parse_progress(line) == told


@pytest.mark.parametrize(
    ("program", "error"),
    [
        (
            "import sys; print('skylight: take care: x\\nskylight: no face in a.jpg; use another\\n"
            "skylight: take care: y', file=sys.stderr); sys.exit(2)",
            "no face in a.jpg; use another",
        ),
        ("import sys; sys.exit(2)", "does not know this command"),
        ("import sys; sys.exit(1)", "ended with code 1"),
        ("import os; os.kill(os.getpid(), 9)", "ended by signal 9"),
    ],
)
def test_a_failure_is_one_line_and_ends_the_run(program: str, error: str) -> None:
    run = Run([python(program), python("print()", stage="never")])
    assert ended(run) == "failed"
    assert error in run.error
    assert "\n" not in run.error
    assert run.stage != "never"


def test_what_to_take_care_of_is_kept() -> None:
    run = Run([python("import sys; print('skylight: take care: grey\\nother', file=sys.stderr)")])
    assert ended(run) == "done"
    assert run.doubts == ["grey"]


@pytest.mark.parametrize("program", ["/nowhere/skylight", "a\0b", str(Path(__file__).parent)])
def test_what_cannot_be_started_is_told(program: str) -> None:
    run = Run([Step("starting", [program])])
    assert run.poll() == "failed"
    assert "set the path in the preferences" in run.error


def test_a_check_of_what_was_printed_stops_the_run() -> None:
    step = python("print('skylight 0.9.0')")
    run = Run([Step(step.stage, step.command, check_version), python("print()", stage="never")])
    assert ended(run) == "failed"
    assert run.error == "skylight 0.9.0: this extension needs skylight 0.3 to below 0.4"
    assert run.stage == "starting"


def test_a_version_of_very_many_digits_is_none() -> None:
    with pytest.raises(Failure, match="this extension needs skylight"):
        check_version(f"skylight 0.{'2' * 5000}")


TIDY = f"""
import pathlib, sys, time
print({LINE!r}, file=sys.stderr, flush=True)
try:
    time.sleep(60)
except KeyboardInterrupt:
    pathlib.Path(PATH).touch()
    sys.exit(1)
"""
DEAF = f"""
import signal, sys, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
print({LINE!r}, file=sys.stderr, flush=True)
time.sleep(60)
"""


@pytest.fixture
def _interrupts() -> object:
    """A shell that started this in the background may have had SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_interrupts")
def test_a_cancelled_process_ends_as_by_ctrl_c(tmp_path: Path) -> None:
    run = Run([python(TIDY.replace("PATH", repr(str(tmp_path / "tidied")))), python("print()")])
    heard(run, "tracing light")
    run.cancel()
    run.cancel()
    assert run.stage == "cancelling"
    assert ended(run) == "cancelled"
    assert (tmp_path / "tidied").exists()
    assert run.error == ""


def test_one_that_does_not_hear_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "PATIENCE_S", 0.1)
    run = Run([python(DEAF)])
    heard(run, "tracing light")
    started = time.monotonic()
    run.cancel()
    assert ended(run) == "cancelled"
    assert time.monotonic() - started < 30


def test_kill_does_not_wait_for_it() -> None:
    run = Run([python(DEAF)])
    heard(run, "tracing light")
    run.kill()
    assert run.poll() == "cancelled"


# what is asked of skylight


def test_the_version_that_there_is_is_compatible() -> None:
    """A release that leaves the range has to try the extension and move it."""
    import skylight

    check_version(f"skylight {skylight.__version__}\n")


@pytest.mark.parametrize(
    "printed",
    ["skylight 0.1.0", "skylight 0.4.0", "skylight 1.1.0", "skylight", "", "Python 0.1.0"],
)
def test_other_versions_are_refused(printed: str) -> None:
    assert COMPATIBLE == ((0, 3), (0, 4))
    with pytest.raises(Failure, match=r"needs skylight 0\.3 to below 0\.4"):
        check_version(printed)


def test_the_commands_are_those_that_skylight_has() -> None:
    """Parsed by skylight itself, up to the file that is not there."""
    from skylight.cli import main

    steps = estimate_steps("skylight", Path("missing.jpg"), Path("out"), "auto")
    for step in steps[1:]:
        assert main(step.command[1:]) == 2  # an error of input, not SystemExit of the parser


def test_portraits_are_relit_by_the_keys_that_skylight_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Parsed by skylight itself, up to what it misses in the estimate's folder."""
    from skylight.cli import main
    from skylight.portrait import _keys as of_skylight

    assert {name for name, *_ in KEYS} == set(of_skylight.KEYS)
    assert SIZES_DEG == (of_skylight.NARROWEST_DEG, of_skylight.WIDEST_DEG)
    assert (USUAL_DEG, USUAL_STRENGTH) == (of_skylight.USUAL_DEG, of_skylight.KEY_OVER_FILL)
    (tmp_path / "estimate.json").write_text("{")
    for name, *_ in KEYS:
        check, step = relight_steps("skylight", tmp_path, name, size_deg=5.5, strength=0.25)
        assert check.check is check_version
        assert main(step.command[1:]) == 2
        assert "person.safetensors" in capsys.readouterr().err
        assert relit_picture(tmp_path, name).parent == tmp_path


@pytest.mark.parametrize("on_path", [True, False])
def test_skylight_is_found_on_path_or_as_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, on_path: bool
) -> None:
    program = tmp_path / "skylight"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path) if on_path else "")
    assert find_skylight(str(program)) == str(program)
    with pytest.raises(Failure, match="no such program"):
        find_skylight(str(tmp_path / "other"))
    if on_path:
        assert find_skylight("") == str(program)
    else:
        with pytest.raises(Failure, match="install it, or set its path"):
            find_skylight("")


def commands(steps: Sequence[Step]) -> list[str]:
    return [step.command[1] for step in steps]


def test_versions_are_asked_before_a_minute_is_spent() -> None:
    steps = estimate_steps("skylight", Path("a.jpg"), Path("out"), "auto")
    assert commands(steps) == ["--version", "estimate", "export"]
