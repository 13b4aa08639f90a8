"""The page's server: what it answers, and to whom."""

import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path

import cv2
import numpy as np
import pytest

from skylight.errors import InputError
from skylight.imaging._film import FilmFrame
from skylight.live import _page
from skylight.live._page import LivePage, serving
from tests.live.test_live import some_light

FRAME = FilmFrame(
    number=7,
    time_s=0.7,
    codes=np.broadcast_to(np.array([200, 120, 40], np.uint8), (48, 64, 3)).copy(),
)


@pytest.fixture
def served(capsys: pytest.CaptureFixture[str]) -> Iterator[tuple[LivePage, int]]:
    with serving(0, browser=False) as page:
        yield page, int(capsys.readouterr().out.rpartition(":")[2])


def asked(port: int, path: str, host: str | None = None) -> tuple[HTTPResponse, bytes]:
    connection = HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer, content


def test_before_the_first_frame_there_is_a_page_and_no_light(served: tuple[LivePage, int]) -> None:
    _, port = served
    answer, html = asked(port, "/")
    assert answer.status == 200
    assert b"skylight live" in html
    assert json.loads(asked(port, "/light.json")[1]) == {"frame": None}
    assert asked(port, "/frame.jpg")[0].status == 404
    assert asked(port, "/../pyproject.toml")[0].status == 404


def test_the_last_frame_and_its_light(served: tuple[LivePage, int]) -> None:
    page, port = served
    page.show(FRAME, None, 9.96)
    assert json.loads(asked(port, "/light.json")[1]) == {
        "frame": 7,
        "rate": 10.0,
        "size": [64, 48],
    }
    light = some_light(np.array([0.0, 0.6, 0.8]), 0.7)
    page.show(FRAME, light, 9.96)
    state = json.loads(asked(port, "/light.json")[1])["light"]
    assert state["direction"] == [0.0, 0.6, 0.8]
    assert state["words"] == light.words
    assert state["main_share"] == 1  # there is no other light
    assert len(state["map"]) == 3 * np.prod(state["map_size"])
    assert len(state["ambient"]) == 27
    answer, jpeg = asked(port, "/frame.jpg")
    assert answer.headers["Content-Type"] == "image/jpeg"
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert shown is not None
    np.testing.assert_allclose(shown, FRAME.codes, atol=4)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "[::1", ""])
def test_a_page_of_another_name_gets_no_picture(served: tuple[LivePage, int], host: str) -> None:
    page, port = served
    page.show(FRAME, None, 1.0)
    connection = HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest("GET", "/frame.jpg", skip_host=True)
    connection.putheader("Host", host)
    connection.endheaders()
    assert connection.getresponse().status == 403
    connection.close()


def test_nothing_is_asked_of_another_machine(served: tuple[LivePage, int]) -> None:
    _, port = served
    answer, html = asked(port, "/")
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    assert b"http://" not in html
    assert b"https://" not in html


@pytest.mark.parametrize("requests", [1, 300], ids=["between", "while pages are sent"])
def test_a_tab_that_closes_is_no_error(
    served: tuple[LivePage, int], requests: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its socket is reset, while the server waits for it or writes to it."""
    _, port = served
    before = threading.active_count()
    tab = socket.create_connection(("127.0.0.1", port), timeout=10)
    tab.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * requests)
    assert tab.recv(1) == b"H"
    assert threading.active_count() > before
    tab.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    tab.close()
    deadline = time.monotonic() + 10
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() == before
    assert capsys.readouterr().err == ""


def test_a_port_that_is_taken_is_told() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port}.*--port"), serving(port, browser=False):
            pass
    with pytest.raises(InputError, match="0 to 65535"), serving(70000, browser=False):
        pass


def test_the_page_is_in_the_package() -> None:
    assert (Path(_page.__file__).parent / "data" / "live.html").is_file()
