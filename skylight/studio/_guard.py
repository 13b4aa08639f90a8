"""What the server refuses: limits, error responses, and the middleware that stands before it all.

A page of another site can send requests to 127.0.0.1, and by DNS rebinding even from a name that it
chose for that address. So the Host must be a name that the server goes by, and whatever changes
something must come from its own page (the Origin that browsers send) or from no page at all.
"""

import asyncio
import errno
import math
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from skylight.errors import InputError
from skylight.work._own_host import is_own

_FULL = (errno.ENOSPC, errno.EDQUOT)


class Refused(HTTPException):
    """An answer of this status with ``{"error": line}``."""

    def __init__(self, status: int, line: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(status, " ".join(line.split()), headers)


def refusal(status: int, line: str, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """The answer that a :class:`Refused` becomes."""
    return JSONResponse({"error": " ".join(line.split())}, status, headers)


async def answer_refusal(_request: Request, error: Exception) -> JSONResponse:
    """For :class:`Refused` and for what the framework itself refuses."""
    assert isinstance(error, HTTPException)
    return refusal(error.status_code, str(error.detail), error.headers)


async def answer_failure(_request: Request, error: Exception) -> JSONResponse:
    """For what should not happen; the traceback goes to the server's terminal."""
    if isinstance(error, OSError) and error.errno in _FULL:
        return refusal(507, f"{error.strerror}; check the server's disk for free space")
    first = str(error).partition("\n")[0]
    line = f"internal error ({type(error).__name__}: {first}); the server's terminal tells more"
    return refusal(500, line)


MEGABYTE = 1_000_000
MEGAPIXEL = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Limits:
    """``upload_mb`` (10^6 bytes) and ``megapixels`` of one file; ``jobs`` waiting or running.

    ``upload_s`` is how long a request may take to come in.

    A picture takes up to about 32 bytes a pixel until its light is known: 1.6 GB for 50 megapixels.

    Photographs and maps are each kept until there are more than ``uploads`` of them or more than
    ``kept_mb``, jobs until there are more than ``results`` or ``kept_mb``; then the oldest that no
    job is using are forgotten.
    """

    upload_mb: float = 50.0
    upload_s: float = 600.0
    megapixels: float = 50.0
    jobs: int = 4
    uploads: int = 32
    results: int = 32
    kept_mb: float = 2000.0

    def __post_init__(self) -> None:
        for name in ("upload_mb", "upload_s", "megapixels", "kept_mb"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise InputError(f"{name} must be above 0 and finite, got {value}")
        for name in ("jobs", "uploads", "results"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be 1 or more, got {getattr(self, name)}")

    @property
    def upload_bytes(self) -> int:
        return int(self.upload_mb * MEGABYTE)

    @property
    def pixels(self) -> int:
        return int(self.megapixels * MEGAPIXEL)

    @property
    def kept_bytes(self) -> int:
        return int(self.kept_mb * MEGABYTE)


JSON_BYTES = 65_536  # of a request for a job
GRACE_S = 10.0  # before the rate of a body counts
LEAST_BYTES_PER_S = 10_000  # on average, after that
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
    """ASGI middleware: foreign hosts and pages get 403, too long bodies 413, too slow ones 408."""

    def __init__(self, app: ASGIApp, host: str, limits: Limits) -> None:
        self._app, self._host, self._limits = app, host, limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        send = _with_headers(send, scope["path"])
        line = self._why_foreign(scope["method"], headers)
        if line is not None:
            await refusal(403, line)(scope, receive, send)
            return
        if scope["path"] == "/api/jobs" and scope["method"] == "POST" and not _is_json(headers):
            line = "a job is asked for in JSON; send it with Content-Type: application/json"
            await refusal(415, line)(scope, receive, send)
            return
        is_upload = scope["path"] in ("/api/photos", "/api/maps")
        most = self._limits.upload_bytes if is_upload else JSON_BYTES
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > most:
            await refusal(413, _too_large(most))(scope, receive, send)
            return
        # files go out whole: what a wrong Range gets from the framework is no JSON
        whole = [pair for pair in scope["headers"] if pair[0] != b"range"]
        body = _bounded(receive, most, self._limits.upload_s)
        await self._app({**scope, "headers": whole}, body, send)

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


def _is_json(headers: Headers) -> bool:
    return headers.get("content-type", "").partition(";")[0].strip().lower() == "application/json"


def _bounded(receive: Receive, most: int, most_s: float) -> Receive:
    """Refuses a body longer than ``most``, whatever the headers said, and one that dawdles.

    After ``GRACE_S + n / LEAST_BYTES_PER_S`` seconds more than n bytes must be in, and all of them
    after ``most_s``.
    """
    total, is_in = 0, False
    begun = asyncio.get_running_loop().time()

    async def bounded() -> Message:
        nonlocal total, is_in
        if is_in:  # what is waited for now is that the client goes
            return await receive()
        last = begun + min(most_s, GRACE_S + total / LEAST_BYTES_PER_S)
        try:
            async with asyncio.timeout_at(last):
                message = await receive()
        except TimeoutError as error:
            raise Refused(408, _too_slow(most_s), {"Connection": "close"}) from error
        total += len(message.get("body", b""))
        if total > most:
            raise Refused(413, _too_large(most))
        is_in = not message.get("more_body", False)
        return message

    return bounded


def _too_slow(most_s: float) -> str:
    rate = f"{LEAST_BYTES_PER_S / 1000:g} kB a second"
    return f"the request came in too slowly: send at least {rate}, and all within {most_s:g} s"


def _too_large(most: int) -> str:
    size = f"{most / 1e6:.3g} MB" if most >= 1_000_000 else f"{most / 1e3:.3g} kB"
    return f"more than {size} in one request, which this server does not take; send less"


def _with_headers(send: Send, path: str) -> Send:
    async def with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.update(_ALWAYS)
            # results are private, and the page must never be older than the server
            headers.setdefault(
                "Cache-Control", "no-store" if path.startswith("/api/") else "no-cache"
            )
        await send(message)

    return with_headers
