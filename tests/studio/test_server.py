"""The server from its start to its end: address, page, headers, foreign pages, limits."""

import gzip
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

from skylight import __version__
from skylight.errors import InputError
from skylight.studio import _server as static_files
from skylight.studio._requests import LIGHTS, PLACES
from skylight.studio._server import serve
from tests.studio.conftest import (
    COMMAND,
    HOSTILE,
    JOBS,
    MEGAPIXELS,
    PATIENCE_S,
    UPLOAD_MB,
    Served,
    start,
)


def test_it_says_what_it_takes(client: httpx.Client) -> None:
    about = client.get("/api/about").json()
    assert about["version"] == __version__
    assert about["limits"] == {"upload_mb": UPLOAD_MB, "megapixels": MEGAPIXELS, "jobs": JOBS}
    assert [light["name"] for light in about["lights"]] == list(LIGHTS)
    assert [place["name"] for place in about["places"]] == list(PLACES)
    assert about["light"] == "sphere"


def test_the_page_is_sent_again_only_where_it_changed(client: httpx.Client) -> None:
    first = client.get("/")
    assert first.status_code == 200
    assert first.headers["content-type"] == "text/html; charset=utf-8"
    assert first.headers["cache-control"] == "no-cache"
    again = client.get("/", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert client.head("/").status_code == 200


def test_packed_files_are_sent_as_what_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from starlette.requests import Request

    (tmp_path / "ort.wasm.gz").write_bytes(gzip.compress(b"\0asm"))
    monkeypatch.setattr(static_files, "STATIC", tmp_path)

    def ask(accepts: bytes) -> tuple[bytes, dict[str, str]]:
        scope = {"type": "http", "headers": [(b"accept-encoding", accepts)]}
        answer = static_files.static_file(Request(scope), "ort.wasm")
        return bytes(answer.body), dict(answer.headers)

    packed, headers = ask(b"gzip, br")
    assert gzip.decompress(packed) == b"\0asm"
    assert headers["content-type"] == "application/wasm"
    assert headers["content-encoding"] == "gzip"
    plain, headers = ask(b"identity")
    assert plain == b"\0asm"
    assert "content-encoding" not in headers


@pytest.mark.parametrize("path", ["/", "/api/about", "/api/nothing"])
def test_every_answer_tells_browsers_to_be_careful(client: httpx.Client, path: str) -> None:
    headers = client.get(path).headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert "'unsafe-inline'" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cross-origin-resource-policy"] == "same-origin"
    assert "server" not in headers


@pytest.mark.parametrize("wanted", ["bytes=0-5", "bytes={}-5", "bytes=9999999999-", "lines=1"])
def test_files_go_out_whole(client: httpx.Client, wanted: str) -> None:
    answer = client.get("/api/sky.onnx", headers={"Range": wanted})
    assert answer.status_code == 200
    assert len(answer.content) == int(answer.headers["content-length"]) > 1_000_000


def test_the_own_page_may_ask(client: httpx.Client) -> None:
    own = str(client.base_url).rstrip("/")
    headers = {"Origin": own, "Sec-Fetch-Site": "same-origin"}
    assert client.delete("/api/jobs/x", headers=headers).status_code == 404


def test_a_taken_port_is_one_line(served: Served) -> None:
    port = served.address.rpartition(":")[2]
    command = [sys.executable, "-m", "skylight", "studio", "--no-browser", "--port", port]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith(f"skylight: cannot listen at 127.0.0.1, port {port}: ")
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("manifest", "said"),
    [
        (None, "it has no bundle.json; make one with: skylight train"),
        ("{", "no JSON"),
        ('{"kind": "light model", "version": 3}', "upgrade skylight"),
        ('{"kind": "light model", "version": 1, "name": "a"}', '"skies" is missing'),
        (
            '{"kind": "light model", "version": 2, "name": "a", "skies": 1, "data_sha256": "",'
            ' "fingerprint": "", "network": "own:Mine"}',
            "its network is own:Mine, a class that is not skylight's: give --network own:Mine",
        ),
    ],
)
def test_a_folder_that_is_no_light_model_is_one_line(
    tmp_path: Path, manifest: str | None, said: str
) -> None:
    if manifest is not None:
        (tmp_path / "bundle.json").write_text(manifest)
    with pytest.raises(InputError) as caught:
        serve(model=tmp_path, port=-1, browser=False)  # no server, were the model let through
    assert said in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    "how",
    [
        signal.SIGINT,
        pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
    ],
)
def test_it_leaves_nothing(tmp_path: Path, portrait: bytes, how: signal.Signals) -> None:
    """Ended while it reads a photograph and has an open connection."""
    studio = start(tmp_path / "tmp")
    host, _, port = studio.address.removeprefix("http://").rpartition(":")
    with studio.client() as client:
        assert client.get("/api/about").status_code == 200
        assert [path.name[:16] for path in studio.temporary.iterdir()] == ["skylight-studio-"]
        with socket.create_connection((host, int(port))) as connection:
            head = f"POST /api/photos HTTP/1.1\r\nHost: {host}\r\nContent-Length: {len(portrait)}"
            connection.sendall(head.encode() + b"\r\n\r\n" + portrait)
            begun = time.monotonic()
            while len(workers := studio.workers()) < 2:
                assert time.monotonic() - begun < PATIENCE_S
                time.sleep(0.01)
            assert studio.end(how) == 0
    assert list(studio.temporary.iterdir()) == []
    assert (tmp_path / "stderr").read_text() == ""
    assert not any(Path(f"/proc/{worker}/cmdline").exists() for worker in workers)


@pytest.mark.skipif(COMMAND is None, reason="skylight is not installed beside this Python")
def test_hostile_modules_in_the_current_folder_are_not_run(served: Served, photo: str) -> None:
    assert {f"{name}.py" for name in HOSTILE} <= {
        path.name for path in served.temporary.parent.iterdir()
    }
    assert photo  # its face was found by a worker process
