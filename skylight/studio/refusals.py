"""Error responses: a status and a line."""

import errno
from collections.abc import Mapping

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse

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
