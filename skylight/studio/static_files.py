"""The built page, served with entity tags."""

import gzip
import hashlib
import mimetypes
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from fastapi import Request
from starlette.responses import Response

from skylight.studio.refusals import Refused

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
