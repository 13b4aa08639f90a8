"""The page of ``skylight live``: a small server of this machine, and what the page asks of it.

The page is one file without anything from elsewhere. It asks for the last light as JSON, and for
the last picture, which may be that of a later frame. A webcam's pictures are private: only this
machine's own pages get them, which a Host header of another name (rebinding of names) tells apart.
"""

import json
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from urllib.parse import urlsplit

import cv2
import numpy as np

from skylight.errors import InputError
from skylight.imaging._film import FilmFrame
from skylight.live._live import Light
from skylight.work._own_host import is_own

HOST = "127.0.0.1"
_JPEG_QUALITY = 85
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self' blob: data:; "
    "connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class LivePage:
    """What the page shows: the last frame and its light, set by one thread and read by others."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._shown: tuple[FilmFrame, Light | None, float] | None = None

    def show(self, frame: FilmFrame, light: Light | None, rate: float) -> None:
        """``rate``: frames a second."""
        with self._lock:
            self._shown = frame, light, rate

    def state(self) -> dict[str, object]:
        """light.json: the number of the frame, and its light where there is one."""
        with self._lock:
            shown = self._shown
        if shown is None:
            return {"frame": None}
        frame, light, rate = shown
        state: dict[str, object] = {
            "frame": frame.number,
            "rate": round(rate, 1),
            "size": frame.codes.shape[1::-1],
        }
        if light is None:
            return state
        radiance = light.radiance_map()
        return state | {
            "light": light.facts()
            | {
                "words": light.words,
                "main_share": round(light.main_share, 4),
                "ambient": np.round(light.ambient[:9].ravel(), 5).tolist(),
                "map": np.round(radiance.ravel(), 4).tolist(),
                "map_size": radiance.shape[1::-1],
            },
        }

    def picture(self) -> bytes | None:
        """The last frame as JPEG."""
        with self._lock:
            shown = self._shown
        if shown is None:
            return None
        bgr = np.ascontiguousarray(shown[0].codes[..., ::-1])
        good, coded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        return coded.tobytes() if good else None


@contextmanager
def serving(port: int, *, browser: bool) -> Iterator[LivePage]:
    """Serve a page at ``port`` (0: a free one) while the block runs, and say where it is."""
    if not 0 <= port <= 65535:
        raise InputError(f"--port must be from 0 to 65535, got {port}")
    page = LivePage()
    try:
        server = ThreadingHTTPServer((HOST, port), _handler(page))
    except OSError as error:
        raise InputError(
            f"cannot listen at {HOST}, port {port}: {error.strerror}; end what uses it, or choose "
            "another with --port"
        ) from error
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    address = f"http://{HOST}:{server.server_address[1]}"
    print(address, flush=True)
    if browser:
        # on a thread: some browsers keep their caller waiting
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    try:
        yield page
    finally:
        server.shutdown()
        server.server_close()


def _handler(page: LivePage) -> type[BaseHTTPRequestHandler]:
    html = (files("skylight.live") / "data" / "live.html").read_bytes()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle(self) -> None:
            with suppress(ConnectionError):  # a tab that was closed
                super().handle()

        def do_GET(self) -> None:
            if not is_own(self.headers.get("Host", ""), HOST):
                self._answer(403, "text/plain", b"open this page as http://127.0.0.1 with its port")
                return
            path = urlsplit(self.path).path
            if path == "/":
                self._answer(200, "text/html; charset=utf-8", html)
            elif path == "/light.json":
                self._answer(200, "application/json", json.dumps(page.state()).encode())
            elif path == "/frame.jpg" and (picture := page.picture()) is not None:
                self._answer(200, "image/jpeg", picture)
            else:
                self._answer(404, "text/plain", b"there is no such page")

        def _answer(self, status: int, kind: str, content: bytes) -> None:
            self.send_response(status)
            for name, value in _HEADERS.items():
                self.send_header(name, value)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing: the terminal is for what is found."""

    return Handler
