"""The studio's server: its HTTP application, the built page, and its life from socket to end.

Errors are JSON, ``{"error": "one line"}``. Files of the page are served with entity tags.
"""

import gzip
import hashlib
import mimetypes
import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.types import ASGIApp

from skylight import __version__
from skylight.errors import InputError
from skylight.models._manifest import places_file, read_manifest
from skylight.studio._guard import Guard, Limits, Refused, answer_failure, answer_refusal, refusal
from skylight.studio._requests import DICTIONARIES, LIGHTS, PLACES, what_is_wrong
from skylight.studio._routes import examples, jobs, uploads
from skylight.studio._state import Studio, own_folder
from skylight.work._progress import Tell

STATIC = Path(str(files("skylight.studio") / "static"))
_GZ = ".gz"
# Not left to the machine's own table, which on some calls JavaScript plain text.
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".wasm": "application/wasm",
}


def static_file(request: Request, name: str) -> Response:
    """A file of the page, or 404. ``name.gz`` is sent as ``name`` in gzip's coding."""
    known = {file.relative_to(STATIC).as_posix(): file for file in STATIC.rglob("*")}
    packed = name not in known
    path = known.get(name + _GZ if packed else name)
    if path is None or not path.is_file():
        raise Refused(404, "there is no such page")
    status = path.stat()
    content, tag = _content(path, status.st_mtime_ns, status.st_size)
    kind = _TYPES.get(Path(name).suffix) or mimetypes.guess_type(name)[0]
    headers = {"ETag": tag, "Content-Type": kind or "application/octet-stream"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers={"ETag": tag})
    if packed:
        headers["Vary"] = "Accept-Encoding"
        if "gzip" in request.headers.get("accept-encoding", ""):
            headers["Content-Encoding"] = "gzip"
        else:
            content = gzip.decompress(content)
    return Response(content, headers=headers)


@lru_cache(maxsize=64)
def _content(path: Path, _changed: int, _size: int) -> tuple[bytes, str]:
    content = path.read_bytes()
    return content, f'"{hashlib.sha256(content).hexdigest()[:32]}"'


pages = APIRouter()


def make_application(studio: Studio, *, host: str) -> ASGIApp:
    """The ASGI application of a server that is bound to ``host``; who runs it ends ``studio``."""

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        studio.start()
        yield

    app = FastAPI(lifespan=lifespan, openapi_url=None, redirect_slashes=False)
    app.state.studio = studio
    app.add_exception_handler(HTTPException, answer_refusal)
    app.add_exception_handler(RequestValidationError, _answer_invalid)
    app.add_exception_handler(Exception, answer_failure)
    for router in (uploads, examples, jobs, pages):
        app.include_router(router)
    return Guard(app, host, studio.limits)


async def _answer_invalid(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    return refusal(422, what_is_wrong(error))


@pages.get("/api/about")
async def about(request: Request) -> dict[str, Any]:
    """What this server is and takes."""
    limits: Limits = request.app.state.studio.limits
    return {
        "version": __version__,
        "limits": {
            "upload_mb": limits.upload_mb,
            "megapixels": limits.megapixels,
            "jobs": limits.jobs,
        },
        "light": request.app.state.studio.light,
        "lights": _choices(LIGHTS.items()),
        "places": _choices(PLACES.items()),
        "dictionaries": _choices(DICTIONARIES.items()),
    }


@pages.get("/api/sky.json")
async def sky(request: Request) -> dict[str, Any]:
    """The latent's main components."""
    return await request.app.state.studio.ask("sky")


@pages.get("/api/sky.onnx")
async def decoder() -> FileResponse:
    """The shipped sky decoder."""
    path = Path(str(files("skylight.models") / "data" / "sky_decoder.onnx"))
    if not path.is_file():
        raise Refused(500, f"{path.name} is missing; reinstall skylight")
    return FileResponse(path, media_type="application/octet-stream")


@pages.get("/api/designs")
async def designs(request: Request) -> dict[str, Any]:
    """The probes to choose from."""
    return await request.app.state.studio.ask("designs")


@pages.api_route("/{name:path}", methods=["GET", "HEAD"])
async def page(request: Request, name: str) -> Response:
    """The built page's files."""
    return static_file(request, name or "index.html")


def _choices(named: Iterable[tuple[str, str]]) -> list[dict[str, str]]:
    return [{"name": name, "title": title} for name, title in named]


_FAREWELL_S = 1  # that open connections have when the server ends
_UNACKNOWLEDGED_MS = 30_000  # after which a client that no longer answers is gone

_say = partial(print, flush=True)  # at once, also to a pipe


def serve(
    *,
    host: str = "127.0.0.1",
    port: int = 8600,
    browser: bool = True,
    limits: Limits | None = None,
    model: Path | None = None,
    network: str | None = None,
    tell: Tell = _say,
) -> None:
    """Serve the studio until Ctrl-C; uploads and results go with it.

    ``model`` is the folder of a trained light model to estimate with, ``network`` the class of its
    network where that is the user's, as module:Class. ``port`` 0 takes one that
    is free. ``tell`` gets the address.

    Raises
    ------
    InputError
        The port is taken, the host is none of this machine's, ``model`` has no readable
        bundle.json, or ``network`` is not its network's class.
    """
    manifest = None if model is None or places_file(model) is not None else read_manifest(model)
    if network is not None or (manifest is not None and manifest.network is not None):
        # else its tensors, which need torch, are read by the worker
        from skylight.models._bundle import load_bundle, own_model

        load_bundle(model) if network is None else own_model(model, network)
    listener = _listening(host, port)
    with listener, own_folder() as folder, _ended_by_signals():
        studio = Studio(
            folder, limits or Limits(), model=model and model.resolve(), network=network
        )
        config = uvicorn.Config(
            make_application(studio, host=host),
            log_config=None,
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=_FAREWELL_S,
        )
        address = _address(host, listener.getsockname()[1])
        tell(address)
        if browser and _has_display():
            # on a thread: some browsers keep their caller waiting
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        try:
            _Server(config, studio).run(sockets=[listener])
        finally:
            studio.end_processes()


class _Server(uvicorn.Server):
    """Ends the studio's work first: its streams of events would keep connections open."""

    def __init__(self, config: uvicorn.Config, studio: Studio) -> None:
        super().__init__(config)
        self._studio = studio

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await self._studio.stop()
        await super().shutdown(sockets)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Ctrl-C, a closed terminal and a polite kill end the block well: its folder is removed."""
    # the server raises again, once it has ended, the signal that ended it
    kept = {signal.SIGTERM: signal.signal(signal.SIGTERM, signal.default_int_handler)}
    if hasattr(signal, "SIGHUP"):
        kept[signal.SIGHUP] = signal.signal(
            signal.SIGHUP, lambda _number, _frame: signal.raise_signal(signal.SIGTERM)
        )
    try:
        with suppress(KeyboardInterrupt):
            yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def _listening(host: str, port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise InputError(f"port must be from 0 to 65535, got {port}")
    try:
        family, kind, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InputError(f"{host}: no address of this machine; leave --host out") from error
    listener = socket.socket(family, kind)
    try:
        if os.name == "posix":
            # a server that has just ended leaves its port in waiting
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # accepted sockets inherit it
            # else the system writes to a machine that vanished for a quarter of an hour
            limit = socket.TCP_USER_TIMEOUT
            listener.setsockopt(socket.IPPROTO_TCP, limit, _UNACKNOWLEDGED_MS)
        listener.bind(where)
        listener.listen()  # so that a browser may come before the server is ready
    except OSError as error:
        listener.close()
        raise InputError(
            f"cannot listen at {host}, port {port}: {error.strerror}; end what uses it, or choose "
            "another with --port"
        ) from error
    return listener


def _address(host: str, port: int) -> str:
    # an address that listens on all of them is no place to go to
    shown = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, host)
    return f"http://{f'[{shown}]' if ':' in shown and shown[0] != '[' else shown}:{port}"


def _has_display() -> bool:
    return not sys.platform.startswith("linux") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
