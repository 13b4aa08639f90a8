"""Settings of a folder, and work in several processes."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError, OutputError, SkylightError
from skylight.work import _resumable as resumable
from skylight.work._resumable import MOST_LOSSES, keep_settings, locked, share_work


def test_a_folder_keeps_its_settings(tmp_path: Path) -> None:
    note = tmp_path / "settings.json"
    keep_settings(note, {"height": 4, "shares": (0.5, 0.5)})
    keep_settings(note, {"shares": (0.5, 0.5), "height": 4})
    with pytest.raises(InputError, match=r'made with other settings .*"height": 4.*"height": 8'):
        keep_settings(note, {"height": 8, "shares": (0.5, 0.5)})
    assert json.loads(note.read_text()) == {"height": 4, "shares": [0.5, 0.5]}


@pytest.mark.parametrize("text", ["{", "[" * 10**5])
def test_a_damaged_note_is_named(tmp_path: Path, text: str) -> None:
    note = tmp_path / "settings.json"
    note.write_text(text)
    with pytest.raises(InputError, match="damaged"):
        keep_settings(note, {"height": 4})


def test_a_folder_has_one_run_at_a_time(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "out"
    with (
        locked(folder),
        pytest.raises(InputError, match="another run is at work there"),
        locked(folder),
    ):
        pass
    with locked(folder):
        pass


@pytest.mark.parametrize("has_locks", [True, False])
def test_what_is_half_written_goes_where_no_other_run_can_be_writing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_locks: bool
) -> None:
    inner = tmp_path / "inner"
    (inner / ".partial-1").mkdir(parents=True)
    half = {inner / ".partial-1" / "a.exr", tmp_path / ".partial-2.csv", inner / ".partial-3.csv"}
    whole = {tmp_path / "a.csv", inner / "b.csv"}
    for file in half | whole:
        file.touch()
    if not has_locks:
        monkeypatch.setattr("fcntl.flock", _no_locks)
    with locked(tmp_path, inner, tmp_path / "none"):
        there = {file for file in tmp_path.rglob("*") if file.is_file()}
    assert there - {tmp_path / ".lock"} == (whole if has_locks else half | whole)


def _no_locks(*_: object) -> None:
    raise OSError(errno.ENOLCK, "no locks available")


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write into"), locked(tmp_path / "file" / "out"):
        pass


def _where(number: int, offset: int) -> tuple[int, int, int, bool]:
    if number < 0:
        raise InputError(f"piece {number}")
    return number + offset, os.getpid(), torch.get_num_threads(), "PREPARED" in os.environ


def _prepare() -> None:
    os.environ["PREPARED"] = "yes"


def test_prepared_processes_of_one_thread_share_work_that_may_grow_and_fail(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    pieces = deque((number, 10) for number in range(4))
    shared = share_work(_where, pieces, workers=2, prepare=_prepare)
    results = [next(shared) for _ in range(4)]
    pieces.append((-1, 10))  # done as well
    with pytest.raises(InputError, match="piece -1"):
        next(shared)
    assert sorted(r[0] for r in results) == [10, 11, 12, 13]
    assert all(pid != os.getpid() for _, pid, _, _ in results)
    assert all(threads == 1 and prepared for _, _, threads, prepared in results)


@pytest.mark.parametrize(("workers", "count"), [(1, 3), (4, 1)])
def test_little_work_stays_here_in_order(workers: int, count: int) -> None:
    work = [(number, 0) for number in range(count)]
    results = list(share_work(_where, work, workers=workers))
    assert [r[0] for r in results] == list(range(count))
    assert {r[1] for r in results} == {os.getpid()}


def _may_die(folder: Path, number: int) -> int:
    with (folder / "tried.txt").open("a") as file:
        file.write(f"{number}\n")
    tries = (folder / "tried.txt").read_text().split().count(str(number))
    if number == 1 or (number == 2 and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.slow
def test_killed_processes_lose_nothing_and_hopeless_pieces_are_answered_for(tmp_path: Path) -> None:
    work = [(tmp_path, number) for number in range(4)]
    results = list(share_work(_may_die, work, workers=2, lost=lambda _, number: -number))
    assert sorted(results) == [-1, 0, 2, 3]
    tried = (tmp_path / "tried.txt").read_text().split()
    assert sorted(tried) == ["0", *["1"] * MOST_LOSSES, "2", "2", "3"]


def test_a_hopeless_piece_without_an_answer_ends_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resumable, "MOST_LOSSES", 1)
    with pytest.raises(SkylightError, match="a process died 1 times at the same piece"):
        list(share_work(_may_die, [(tmp_path, 1), (tmp_path, 1)], workers=2))


def test_work_may_be_added_where_results_are_taken() -> None:
    queue, found = deque([(3, 0), (2, 0)]), []
    for number, *_ in share_work(_where, queue, workers=1):
        found.append(number)
        if number > 0:
            queue.appendleft((number - 1, 0))
    assert found == [3, 2, 1, 0, 2, 1, 0]


def _begin_and_end(folder: Path, number: int, seconds: float) -> int:
    beside = folder / f"beginning{number}"
    beside.write_text(str(os.getpid()))
    beside.rename(folder / f"begun{number}")  # whoever waits for it finds the number in it
    time.sleep(seconds)
    (folder / f"ended{number}").touch()
    return number


def _is_even(_: Path, number: int, __: float) -> bool:
    return number % 2 == 0


def share_and_tell(folder: str, seconds: str, finish: str) -> None:
    """Eight pieces in two processes, in a process of its own; prints those that came."""
    work = [(Path(folder), number, float(seconds)) for number in range(8)]
    try:
        chosen = _is_even if finish == "even" else finish == "finish"
        for number in share_work(_begin_and_end, work, workers=2, finish=chosen):
            print(number, flush=True)
    except KeyboardInterrupt:
        print("interrupted", flush=True)


def _sharing(folder: Path, seconds: float, finish: str) -> subprocess.Popen[str]:
    script = (
        # shells that start something in the background let it ignore Ctrl-C, and so its children
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "import sys; from tests.work.test_resumable import share_and_tell as run; run("
    )
    return subprocess.Popen(
        [sys.executable, "-c", script + "*sys.argv[1:])", str(folder), str(seconds), finish],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )


def _wait(condition: Callable[[], bool]) -> None:
    for _ in range(1200):
        if condition():
            return
        time.sleep(0.05)
    raise TimeoutError


@pytest.mark.slow
def test_work_ends_with_the_process_that_shares_it(tmp_path: Path) -> None:
    parent = _sharing(tmp_path, 60, "")
    _wait(lambda: len(list(tmp_path.glob("begun*"))) == 2)
    workers = [int(file.read_text()) for file in tmp_path.glob("begun*")]
    parent.kill()
    parent.communicate()
    _wait(lambda: not any(_is_alive(pid) for pid in workers))


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("finish", "killed"), [("finish", ""), ("finish", "0"), ("", ""), ("even", "")]
)
def test_ctrl_c_finishes_the_pieces_at_work_where_asked(
    tmp_path: Path, finish: str, killed: str
) -> None:
    parent = _sharing(tmp_path, 1.0 if finish else 60, finish)
    _wait(lambda: len(list(tmp_path.glob("begun*"))) == 2)
    os.killpg(parent.pid, signal.SIGINT)  # as a terminal does: to the workers as well
    if killed:
        os.kill(int((tmp_path / f"begun{killed}").read_text()), signal.SIGKILL)
    told, errors = parent.communicate(timeout=60)
    *numbers, last = told.split()
    assert last == "interrupted"
    begun, ended = (
        {file.name[5:] for file in tmp_path.glob(f"{what}*")} for what in ("begun", "ended")
    )
    expected = begun - {killed} if finish else set()
    assert set(numbers) == expected - ({"1"} if finish == "even" else set())
    assert ended == expected
    assert len(begun) < 8
    assert errors == ""
