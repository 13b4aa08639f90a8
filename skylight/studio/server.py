"""The life of a server: socket, folder, processes, browser."""

import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import uvicorn

from skylight.errors import InputError
from skylight.models.bundle_manifest import read_manifest
from skylight.studio.application import make_application
from skylight.studio.limits import Limits
from skylight.studio.own_folder import own_folder
from skylight.studio.state import Studio
from skylight.work.progress import Tell

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
    tell: Tell = _say,
) -> None:
    """Serve the studio until Ctrl-C; uploads and results go with it.

    ``model`` is the folder of a trained light model to estimate with. ``port`` 0 takes one that
    is free. ``tell`` gets the address.

    Raises
    ------
    InputError
        The port is taken, the host is none of this machine's, or ``model`` has no readable
        bundle.json.
    """
    if model is not None:
        read_manifest(model)  # its tensors need torch, and are read by the worker
    listener = _listening(host, port)
    with listener, own_folder() as folder, _ended_by_signals():
        studio = Studio(folder, limits or Limits(), model=model and model.resolve())
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
