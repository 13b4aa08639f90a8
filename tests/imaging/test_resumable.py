"""Settings of a folder, and work in several processes."""

import json
import os
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.imaging.resumable import settle, share_work


def test_a_folder_keeps_its_settings(tmp_path: Path) -> None:
    note = tmp_path / "settings.json"
    settle(note, {"height": 4, "shares": (0.5, 0.5)})
    settle(note, {"shares": (0.5, 0.5), "height": 4})
    with pytest.raises(InputError, match=r'made with other settings .*"height": 4.*"height": 8'):
        settle(note, {"height": 8, "shares": (0.5, 0.5)})
    assert json.loads(note.read_text()) == {"height": 4, "shares": [0.5, 0.5]}


def test_a_damaged_note_is_named(tmp_path: Path) -> None:
    note = tmp_path / "settings.json"
    note.write_text("{")
    with pytest.raises(InputError, match="damaged"):
        settle(note, {"height": 4})


def _where(number: int, offset: int) -> tuple[int, int, int, bool]:
    return number + offset, os.getpid(), torch.get_num_threads(), "PREPARED" in os.environ


def _prepare() -> None:
    os.environ["PREPARED"] = "yes"


def test_work_is_shared_by_prepared_processes_of_one_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    work = [(number, 10) for number in range(4)]
    results = list(share_work(_where, work, workers=2, prepare=_prepare))
    assert sorted(r[0] for r in results) == [10, 11, 12, 13]
    assert all(pid != os.getpid() for _, pid, _, _ in results)
    assert all(threads == 1 and prepared for _, _, threads, prepared in results)


@pytest.mark.parametrize(("workers", "count"), [(1, 3), (4, 1)])
def test_little_work_stays_here_in_order(workers: int, count: int) -> None:
    work = [(number, 0) for number in range(count)]
    results = list(share_work(_where, work, workers=workers))
    assert [r[0] for r in results] == list(range(count))
    assert {r[1] for r in results} == {os.getpid()}


def _fail(number: int) -> None:
    raise InputError(f"piece {number}")


def test_a_failure_reaches_the_caller() -> None:
    with pytest.raises(InputError, match="piece"):
        list(share_work(_fail, [(1,), (2,), (3,)], workers=2))
