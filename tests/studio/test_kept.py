"""What a server keeps, and when it forgets."""

import asyncio
from base64 import b64encode
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from starlette.types import Message

from skylight.errors import InputError
from skylight.studio._guard import Limits, Refused
from skylight.studio._jobs import Item, Job, Kept, KeptFile
from skylight.studio._requests import LampsEdit
from skylight.studio._state import Studio


def _kept(tmp_path: Path, sizes: list[int], *, most: int, most_bytes: int) -> Kept[Item]:
    kept: Kept[Item] = Kept(tmp_path / "things", "thing", most=most, most_bytes=most_bytes)
    for size in sizes:
        item = Item(folder=kept.new_folder())
        (item.folder / "file").write_bytes(bytes(size))
        kept.add(item)
    return kept


@pytest.mark.parametrize(
    ("most", "most_bytes", "left"),
    [(9, 10**6, [10, 20, 30]), (2, 10**6, [20, 30]), (9, 50, [20, 30]), (9, 49, [30]), (1, 1, [])],
)
def test_the_oldest_go_first(tmp_path: Path, most: int, most_bytes: int, left: list[int]) -> None:
    kept = _kept(tmp_path, [10, 20, 30], most=most, most_bytes=most_bytes)
    kept.make_room(lambda _: False)
    assert [item.bytes for item in kept] == left
    assert len(list((tmp_path / "things").iterdir())) == len(left)


def test_what_is_in_use_stays(tmp_path: Path) -> None:
    kept = _kept(tmp_path, [10, 20, 30], most=1, most_bytes=10**6)
    kept.make_room(lambda item: item.bytes == 10)
    assert [item.bytes for item in kept] == [10]


def test_files_that_are_read_outlive_their_item(tmp_path: Path) -> None:
    kept = _kept(tmp_path, [10], most=1, most_bytes=99)
    (item,) = kept
    with kept.reading(item):
        with kept.reading(item):
            kept.forget(item)
        assert (item.folder / "file").exists()
        with pytest.raises(Refused):
            kept.get(item.id)
    assert not item.folder.exists()


def test_a_file_that_is_forgotten_while_it_is_sent_goes_out_whole(tmp_path: Path) -> None:
    kept = _kept(tmp_path, [100_000], most=1, most_bytes=10**6)
    (item,) = kept
    answer = KeptFile(kept, item, item.folder / "file")
    sent = b""

    async def send(message: Message) -> None:
        nonlocal sent
        kept.forget(item)  # when nothing but its size is known yet
        sent += message.get("body", b"")

    async def receive() -> Message:
        return await asyncio.Future()  # the client stays

    scope = {"type": "http", "method": "GET", "headers": []}
    with ThreadPoolExecutor(1) as thread:  # the main one may hold the loop of the browser's driver
        thread.submit(asyncio.run, answer(scope, receive, send)).result()
    assert sent == bytes(100_000)
    assert not item.folder.exists()


def test_lamps_are_edited_to_the_end_where_their_job_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    studio = Studio(tmp_path, Limits())
    job = Job(folder=studio.jobs.kept.new_folder(), kind="estimate", arguments={}, state="done")
    studio.jobs.kept.add(job)

    async def read(task: str, arguments: dict[str, str]) -> dict[str, str]:
        studio.jobs.forget(job)
        assert (task, Path(arguments["folder"]).is_dir()) == ("lamps", True)
        return {"content": b64encode(b"map").decode()}

    monkeypatch.setattr(studio, "_read", read)
    edit = LampsEdit(azimuth_deg=[0.0], zenith_deg=[0.0], on=[True], ambient=True)
    with ThreadPoolExecutor(1) as thread:
        edited = studio.under_edited_lamps(job, "probe.exr", edit)
        assert thread.submit(asyncio.run, edited).result() == b"map"
    assert not job.folder.exists()


def test_ids_are_not_guessed_and_not_folders(tmp_path: Path) -> None:
    kept = _kept(tmp_path, [1, 1], most=9, most_bytes=9)
    first, second = kept
    assert len({first.id, second.id, first.folder.name, second.folder.name}) == 4
    assert kept.get(first.id) is first
    with pytest.raises(Refused, match="no such thing") as refused:
        kept.get(first.folder.name)
    assert refused.value.status_code == 404


@pytest.mark.parametrize(
    "wrong", [{"jobs": 0}, {"upload_s": 0.0}, {"upload_mb": 0.0}, {"megapixels": float("nan")}]
)
def test_limits_are_above_nothing(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        Limits(**wrong)  # pyright: ignore[reportArgumentType]
