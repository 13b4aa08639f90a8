"""Clients that dawdle, and pages that are gone: what they held is let go.

The server's jobs wait for ever, because its worker processes are not started.
"""

import asyncio
import ctypes
import json
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn

from skylight.studio import _guard as guard, _jobs as jobs, _server as server
from skylight.studio._guard import Limits
from skylight.studio._server import make_application
from skylight.studio._state import UPLOADS_AT_ONCE, Studio
from tests.studio.conftest import PATIENCE_S

UPLOAD_S = 1.0
GONE_S, UNHEARD_S, HEARTBEAT_S, UNACKNOWLEDGED_S = 0.3, 1.0, 0.1, 1.0
PROBE = {"kind": "partitions", "design": "6d"}


@pytest.fixture(autouse=True)
def _short_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "GONE_S", GONE_S)
    monkeypatch.setattr(jobs, "UNHEARD_S", UNHEARD_S)
    monkeypatch.setattr(jobs, "HEARTBEAT_S", HEARTBEAT_S)
    monkeypatch.setattr(server, "_UNACKNOWLEDGED_MS", int(1000 * UNACKNOWLEDGED_S))


@pytest.fixture
def idle(tmp_path: Path) -> Iterator[tuple[Studio, int]]:
    """A studio and the port of its server."""
    studio = Studio(tmp_path, Limits(upload_s=UPLOAD_S, jobs=3))
    app = make_application(studio, host="127.0.0.1")
    config = uvicorn.Config(app, lifespan="off", log_config=None, timeout_graceful_shutdown=1)
    running = uvicorn.Server(config)
    with server._listening("127.0.0.1", 0) as listener:
        thread = threading.Thread(target=running.run, args=([listener],))
        thread.start()
        yield studio, listener.getsockname()[1]
        running.should_exit = True
        thread.join()


@pytest.fixture
def asking(idle: tuple[Studio, int]) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=f"http://127.0.0.1:{idle[1]}", timeout=PATIENCE_S) as client:
        yield client


def _begun(asking: httpx.Client) -> str:
    return asking.post("/api/jobs", json=PROBE).json()["job"]


def _connected(port: int, head: str) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
    connection.sendall(f"{head} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n".encode())
    return connection


def _uploading(port: int) -> socket.socket:
    connection = _connected(port, "POST /api/photos?name=me.jpg")
    connection.sendall(b"Content-Length: 100000\r\n\r\n" + bytes(1000))
    return connection


def _answer(connection: socket.socket) -> bytes:
    """All that comes until the server ends the connection."""
    return b"".join(iter(lambda: connection.recv(4096), b""))


def _is_refused_as_slow(answer: bytes) -> bool:
    head, _, body = answer.partition(b"\r\n\r\n")
    line = json.loads(body)["error"]
    assert "\n" not in line
    return head.startswith(b"HTTP/1.1 408") and "kB a second" in line


def _becomes(is_so: Callable[[], bool]) -> float:
    """The seconds until it is so."""
    begun = time.monotonic()
    while not is_so():
        assert time.monotonic() - begun < PATIENCE_S
        time.sleep(0.01)
    return time.monotonic() - begun


def test_uploads_that_do_not_come_in_hold_nothing(
    idle: tuple[Studio, int], asking: httpx.Client, tmp_path: Path
) -> None:
    _, port = idle
    with ExitStack() as stack:
        slow = [stack.enter_context(_uploading(port)) for _ in range(UPLOADS_AT_ONCE)]
        _becomes(lambda: len(list((tmp_path / "photos").iterdir())) == UPLOADS_AT_ONCE)
        assert asking.post("/api/photos", content=b"x").status_code == 429
        begun = time.monotonic()
        assert all(_is_refused_as_slow(_answer(connection)) for connection in slow)
        assert time.monotonic() - begun < guard.GRACE_S  # for the whole time that they may take
    assert list((tmp_path / "photos").iterdir()) == []
    assert asking.post("/api/photos", content=b"").status_code == 400  # there is room again


def test_an_upload_whose_sender_has_gone_is_forgotten(
    idle: tuple[Studio, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a page goes that another photo was given while faces were looked for."""
    studio, port = idle
    reading, done = threading.Event(), threading.Event()

    async def read(task: str, arguments: dict[str, Any]) -> dict[str, Any]:
        reading.set()
        while not done.is_set():
            await asyncio.sleep(0.01)
        return {"size": [1, 1], "faces": [], "notes": []}

    monkeypatch.setattr(studio, "_read", read)
    head = "Content-Length: 4\r\nConnection: close\r\n\r\n"
    for stays in (True, False):
        reading.clear()
        done.clear()
        with _connected(port, "POST /api/photos?name=me.jpg") as connection:
            connection.sendall(f"{head}data".encode())
            assert reading.wait(PATIENCE_S)
            if stays:
                done.set()
                assert _answer(connection).startswith(b"HTTP/1.1 201")
                assert len(list((tmp_path / "photos").iterdir())) == 1
        time.sleep(0.2)  # for the server to hear of it
        done.set()
    _becomes(lambda: studio._uploading == 0)
    assert len(list((tmp_path / "photos").iterdir())) == 1  # of the one that stayed


def test_bodies_need_a_least_rate(
    idle: tuple[Studio, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard, "GRACE_S", 0.2)
    monkeypatch.setattr(guard, "LEAST_BYTES_PER_S", 2000)
    _, port = idle
    # half of the least rate, and twelve times it
    assert _is_refused_as_slow(_dripped(port, piece=20, every_s=0.02))
    assert _dripped(port, piece=500, every_s=0.02).startswith(b"HTTP/1.1 202")


def _dripped(port: int, *, piece: int, every_s: float) -> bytes:
    """The answer to a request for a job of 15 kB that comes in pieces."""
    body = json.dumps(PROBE).encode().ljust(15_000)
    with _connected(port, "POST /api/jobs") as connection:
        head = f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n"
        connection.sendall((head + "Connection: close\r\n\r\n").encode())
        connection.setblocking(False)
        for start in range(0, len(body), piece):
            connection.sendall(body[start : start + piece])
            time.sleep(every_s)
            try:
                return connection.recv(4096)
            except BlockingIOError:
                continue
        connection.settimeout(PATIENCE_S)
        return _answer(connection)


def _watching(port: int, job: str) -> socket.socket:
    """A stream of events whose first has come in."""
    connection = _connected(port, f"GET /api/jobs/{job}/events")
    connection.sendall(b"\r\n")
    received = b""
    while b"data: " not in received:
        received += connection.recv(4096)
    return connection


def test_a_stream_has_a_heartbeat(asking: httpx.Client) -> None:
    with asking.stream("GET", f"/api/jobs/{_begun(asking)}/events") as stream:
        begun = time.monotonic()
        lines = (line for line in stream.iter_lines() if line)
        told = [json.loads(line.removeprefix("data: ")) for line in islice(lines, 3)]
    assert told[0] == told[1] == told[2]
    assert time.monotonic() - begun > 1.5 * HEARTBEAT_S


@pytest.mark.parametrize("how", ["closed", "reset"])
def test_a_job_whose_connection_ends_is_cancelled(
    idle: tuple[Studio, int], asking: httpx.Client, how: str
) -> None:
    studio, port = idle
    connection = _watching(port, _begun(asking))
    (job,) = studio.jobs.kept
    if how == "reset":
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    assert job.state == "waiting"
    connection.close()
    assert _becomes(lambda: job.state == "cancelled") > 0.5 * GONE_S


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(socket, "TCP_USER_TIMEOUT"), reason="how long to wait for a dead peer is fixed here"
)
def test_a_job_whose_machine_vanished_is_cancelled(
    idle: tuple[Studio, int], asking: httpx.Client
) -> None:
    """Without a word: from some moment on no packet reaches the client, nor is one acknowledged."""
    studio, port = idle
    with _watching(port, _begun(asking)) as connection:
        (job,) = studio.jobs.kept
        time.sleep(1.5 * UNHEARD_S)
        assert job.state == "waiting"  # while it only says nothing
        _deafen(connection)
        assert _becomes(lambda: job.state == "cancelled") > 0.5 * UNACKNOWLEDGED_S


def _deafen(connection: socket.socket) -> None:
    """Every packet that comes for it is dropped before TCP sees it (Linux)."""
    attach = 26  # SO_ATTACH_FILTER
    program = ctypes.create_string_buffer(struct.pack("HBBI", 0x06, 0, 0, 0))  # return 0 bytes
    filter_ = struct.pack("HP", 1, ctypes.addressof(program))
    connection.setsockopt(socket.SOL_SOCKET, attach, filter_)


def test_a_job_that_nobody_watches_is_cancelled(
    idle: tuple[Studio, int], asking: httpx.Client
) -> None:
    studio, _ = idle
    token = _begun(asking)
    (job,) = studio.jobs.kept
    begun = time.monotonic()
    while time.monotonic() - begun < 1.3 * UNHEARD_S:  # a program that asks is as good as a page
        assert asking.get(f"/api/jobs/{token}").json()["state"] == "waiting"
        time.sleep(0.1 * UNHEARD_S)
    assert _becomes(lambda: job.state == "cancelled") > 0.5 * UNHEARD_S


def test_those_who_wait_are_told_how_many_are_before(
    idle: tuple[Studio, int], asking: httpx.Client
) -> None:
    _, port = idle
    tokens = [_begun(asking) for _ in range(3)]
    streams = [_watching(port, token) for token in tokens]
    described = [asking.get(f"/api/jobs/{token}").json() for token in tokens]
    assert [each["before"] for each in described] == [0, 1, 2]
    streams[2].settimeout(PATIENCE_S)
    assert asking.delete(f"/api/jobs/{tokens[0]}").status_code == 204
    received = b""
    while b'"before": 1' not in received:
        received += streams[2].recv(4096)
    assert "before" not in asking.get(f"/api/jobs/{tokens[0]}").json()
    for stream in streams:
        stream.close()
