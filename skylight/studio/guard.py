"""Access control: origins, request sizes, security headers.

A page of another site can send requests to 127.0.0.1, and by DNS rebinding even from a name that it
chose for that address. So the Host must be a name that the server goes by, and whatever changes
something must come from its own page (the Origin that browsers send) or from no page at all.
"""

import ipaddress
import socket
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from skylight.studio.refusals import Refused, refusal

LOOPBACK = ("127.0.0.1", "localhost", "::1")
JSON_BYTES = 65_536  # of a request for a job
_SAFE = ("GET", "HEAD", "OPTIONS")
_ALWAYS = {
    "Content-Security-Policy": "; ".join(
        [
            "default-src 'self'",
            "script-src 'self' 'wasm-unsafe-eval'",
            "worker-src 'self' blob:",
            "img-src 'self' blob: data:",
            "connect-src 'self' blob: data:",
            "object-src 'none'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        ]
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    # these two together allow threads to WebAssembly
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
}


class Guard:
    """ASGI middleware: foreign hosts and pages get 403, too long bodies 413."""

    def __init__(self, app: ASGIApp, host: str, upload_bytes: int) -> None:
        self._app, self._host, self._upload_bytes = app, host, upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        told = _with_headers(send, scope["path"])
        line = self._why_foreign(scope["method"], headers)
        if line is not None:
            await refusal(403, line)(scope, receive, told)
            return
        if scope["path"] == "/api/jobs" and scope["method"] == "POST" and not _is_json(headers):
            line = "a job is asked for in JSON; send it with Content-Type: application/json"
            await refusal(415, line)(scope, receive, told)
            return
        is_upload = scope["path"] in ("/api/photos", "/api/maps")
        most = self._upload_bytes if is_upload else JSON_BYTES
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > most:
            await refusal(413, _too_large(most))(scope, receive, told)
            return
        # files go out whole: what a wrong Range gets from the framework is no JSON
        whole = [pair for pair in scope["headers"] if pair[0] != b"range"]
        await self._app({**scope, "headers": whole}, _counted(receive, most), told)

    def _why_foreign(self, method: str, headers: Headers) -> str | None:
        host = headers.get("host", "")
        if not is_own(host, self._host):
            return f"{host!r} is not this server's name; open it as http://127.0.0.1 with its port"
        if method in _SAFE:
            return None
        origin = headers.get("origin")
        if origin is not None and _place(origin) != host:
            return f"a page of {origin} may not drive this server"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return "a page of another site may not drive this server"
        return None


def _place(origin: str) -> str:
    """The host and port of an Origin; nothing where it is none."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def is_own(host: str, bound: str) -> bool:
    """Whether a Host header names this server, which was bound to the host ``bound``.

    By any address where it listens on all of them: what rebinding needs is a name.
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    if name in (*LOOPBACK, bound.lower()):
        return True
    if bound not in ("0.0.0.0", "::"):
        return False
    return name == socket.gethostname().lower() or _is_address(name)


def _is_json(headers: Headers) -> bool:
    return headers.get("content-type", "").partition(";")[0].strip().lower() == "application/json"


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _counted(receive: Receive, most: int) -> Receive:
    """Refuses a body that turns out longer than the headers said, or that said nothing."""
    total = 0

    async def counted() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > most:
            raise Refused(413, _too_large(most))
        return message

    return counted


def _too_large(most: int) -> str:
    size = f"{most / 1e6:.3g} MB" if most >= 1_000_000 else f"{most / 1e3:.3g} kB"
    return f"more than {size} in one request, which this server does not take; send less"


def _with_headers(send: Send, path: str) -> Send:
    async def told(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.update(_ALWAYS)
            # results are private, and the page must never be older than the server
            headers.setdefault(
                "Cache-Control", "no-store" if path.startswith("/api/") else "no-cache"
            )
        await send(message)

    return told
