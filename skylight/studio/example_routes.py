"""Routes of the photographs to try."""

from functools import lru_cache
from io import BytesIO

from fastapi import APIRouter
from PIL import Image
from starlette.responses import Response

from skylight.app.estimate.examples import EXAMPLES
from skylight.studio.refusals import Refused

examples = APIRouter(prefix="/api/examples")
_NAMED = {example.name: example for example in EXAMPLES}


@examples.get("")
async def described() -> list[dict[str, str]]:
    """Which there are, and what comes of each."""
    return [
        {
            "name": example.name,
            "description": example.description,
            "expected": example.expected,
            "credit": f"{example.author}, {example.licence}",
        }
        for example in EXAMPLES
    ]


@examples.get("/{name}.png")
def picture(name: str) -> Response:  # not async: what is read and encoded is so in a thread
    """One of them, as a file that a user could have chosen."""
    if name not in _NAMED:
        raise Refused(404, f"there is no such example; choose one of {', '.join(_NAMED)}")
    return Response(_png(name), media_type="image/png")


@lru_cache
def _png(name: str) -> bytes:
    buffer = BytesIO()
    Image.fromarray(_NAMED[name].codes()).save(buffer, format="PNG")
    return buffer.getvalue()
