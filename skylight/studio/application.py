"""The HTTP application; errors are JSON, ``{"error": "one line"}``."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.types import ASGIApp

from skylight import __version__
from skylight.studio.example_routes import examples
from skylight.studio.guard import Guard
from skylight.studio.job_routes import jobs
from skylight.studio.limits import Limits
from skylight.studio.refusals import Refused, answer_failure, answer_refusal, refusal
from skylight.studio.requests import DICTIONARIES, LIGHTS, what_is_wrong
from skylight.studio.state import Studio
from skylight.studio.static_files import static_file
from skylight.studio.upload_routes import uploads

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
        "lights": _choices(LIGHTS),
        "dictionaries": _choices(DICTIONARIES),
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


def _choices(named: dict[str, str]) -> list[dict[str, str]]:
    return [{"name": name, "title": title} for name, title in named.items()]
