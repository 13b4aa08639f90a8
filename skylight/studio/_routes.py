"""Routes of the HTTP interface: jobs with their events and files, examples, and uploads."""

import json
import zipfile
from collections.abc import AsyncIterator
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from PIL import Image
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from skylight._names import is_trained
from skylight.estimation._examples import EXAMPLES
from skylight.io._atomic import atomic_path
from skylight.studio._guard import Refused
from skylight.studio._jobs import Job, Jobs, KeptFile, events
from skylight.studio._requests import (
    CodeRequest,
    EstimateRequest,
    JobRequest,
    LampsEdit,
    PortraitRequest,
)
from skylight.studio._state import Studio, Upload

jobs = APIRouter(prefix="/api/jobs")
_PACKED = "files.zip"
_LIGHT = "probe.exr"  # of an estimate


@jobs.post("")
async def begin(request: Request, wanted: JobRequest) -> JSONResponse:
    """Put a job into the queue."""
    studio = _studio(request)
    arguments = wanted.model_dump(exclude={"kind", "photo", "map", "job"})
    if isinstance(wanted, EstimateRequest):
        photo = studio.photos.get(wanted.photo)
        arguments |= {"path": str(photo.path), "name": photo.name, "pixels": studio.limits.pixels}
        light = wanted.light or studio.light
        arguments["light"] = light
        if studio.model is not None and is_trained(light, of_places=studio.of_places):
            arguments |= {"model": str(studio.model), "network": studio.network}
        uses = (photo.id,)
    elif isinstance(wanted, PortraitRequest):
        photo, estimate = _estimated(studio, wanted.job)
        arguments |= {"path": str(photo.path), "name": photo.name, "pixels": studio.limits.pixels}
        arguments |= {"estimate": str(estimate.folder)}
        uses = (photo.id, estimate.id)
    else:
        light, uses = _light(studio, wanted.map, wanted.job)
        if light is None and isinstance(wanted, CodeRequest):
            raise Refused(422, "a code is of a map of light: name a map, or the job that found one")
        arguments |= {"light": light}
    job = studio.jobs.add(wanted.kind, arguments, uses)
    return JSONResponse({"job": job.id}, 202)


def _estimated(studio: Studio, token: str) -> tuple[Upload, Job]:
    """The photograph of an estimate that is done, and that estimate."""
    job = studio.jobs.kept.get(token)
    if job.kind != "estimate" or job.state != "done":
        raise Refused(409, "that job has found no person's light; name an estimate that is done")
    (photo,) = job.uses
    return studio.photos.get(photo), job


def _light(
    studio: Studio, map_: str | None, job: str | None
) -> tuple[dict[str, str] | None, tuple[str, ...]]:
    """(path and name of a map of light, what it belongs to)."""
    if map_ is not None and job is not None:
        raise Refused(422, "name a map or a job, not both")
    if map_ is not None:
        upload = studio.maps.get(map_)
        return {"path": str(upload.path), "name": upload.name}, (upload.id,)
    if job is not None:
        found = studio.jobs.kept.get(job)
        if _LIGHT not in found.files:
            raise Refused(409, "that job has no light to use; name an estimate that is done")
        return {"path": str(found.files[_LIGHT]), "name": _LIGHT}, (found.id,)
    return None, ()


@jobs.get("/{token}")
async def describe(request: Request, token: str) -> dict[str, Any]:
    """How far it is; with its result once it is done."""
    job = _job(request, token)
    _studio(request).jobs.heard(job)
    return job.describe()


@jobs.get("/{token}/events")
async def follow(request: Request, token: str) -> StreamingResponse:
    """The same whenever it changes and as a heartbeat, as server-sent events."""
    return _Events(_studio(request).jobs, _job(request, token))


@jobs.delete("/{token}")
async def cancel_or_forget(request: Request, token: str) -> Response:
    """Stop it; or, where it is over, forget it with its files."""
    studio, job = _studio(request), _job(request, token)
    if job.is_over:
        studio.jobs.forget(job)
    else:
        studio.jobs.cancel(job)
    return Response(status_code=204)


@jobs.get("/{token}/files.zip")
async def packed_files(request: Request, token: str, download: bool = False) -> KeptFile:
    """All its files."""
    studio, job = _studio(request), _job(request, token)
    if not job.files:
        raise Refused(409, "this job has no files (yet)")
    path = job.folder / _PACKED
    if not path.exists():
        with studio.jobs.kept.reading(job):
            await run_in_threadpool(_pack, job, path)
        _job(request, token)  # 404 where it was forgotten meanwhile
    return _file(studio, job, path, download)


@jobs.get("/{token}/files/{name}")
async def one_file(request: Request, token: str, name: str, download: bool = False) -> KeptFile:
    """One of its files, by the name in its own list."""
    studio, job = _studio(request), _job(request, token)
    files = job.files
    if name not in files:
        raise Refused(404, "this job has no file of that name (yet)")
    return _file(studio, job, files[name], download)


@jobs.get("/{token}/lamps/{name}")
async def under_edited_lamps(
    request: Request,
    token: str,
    name: Literal["face.png", "probe.exr", "probe.hdr"],
    edit: Annotated[LampsEdit, Query()],
) -> Response:
    """An estimate's faces or map under its lamps, moved and switched; nothing is kept of it."""
    job = _job(request, token)
    count = len((job.result or {}).get("lamps", []))
    if count == 0:
        raise Refused(409, "that job has no lamps to move; name an estimate that found some")
    if not len(edit.azimuth_deg) == len(edit.zenith_deg) == len(edit.on) == count:
        raise Refused(422, f"give azimuth_deg, zenith_deg and on for each lamp: there are {count}")
    content = await _studio(request).under_edited_lamps(job, name, edit)
    kind = "attachment" if edit.download else "inline"
    headers = {"Content-Disposition": f'{kind}; filename="edited_{name}"'}
    media = "image/png" if name.endswith(".png") else "application/octet-stream"
    return Response(content, media_type=media, headers=headers)


class _Events(StreamingResponse):
    """Its job is watched until it ends, however that is: a generator may be closed much later."""

    def __init__(self, jobs: Jobs, job: Job) -> None:
        super().__init__(self._lines(job), media_type="text/event-stream")
        self._watching = partial(jobs.watching, job)

    @staticmethod
    async def _lines(job: Job) -> AsyncIterator[str]:
        async for description in events(job):
            yield f"data: {json.dumps(description)}\n\n"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._watching():
            await super().__call__(scope, receive, send)


def _file(studio: Studio, job: Job, path: Path, download: bool) -> KeptFile:
    kind = "attachment" if download else "inline"
    kept = studio.jobs.kept
    return KeptFile(kept, job, path, filename=path.name, content_disposition_type=kind)


def _pack(job: Job, path: Path) -> None:
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, file in job.files.items():
            archive.write(file, name, zipfile.ZIP_DEFLATED)


def _job(request: Request, token: str) -> Job:
    return _studio(request).jobs.kept.get(token)


def _studio(request: Request) -> Studio:
    return request.app.state.studio


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


uploads = APIRouter(prefix="/api")


@uploads.post("/photos")
async def take_photo(request: Request, name: str = "") -> JSONResponse:
    """A photograph as the raw body."""
    photo = await _studio(request).take_photo(request, name)
    return JSONResponse({"photo": photo.id, **_described(photo)}, 201)


@uploads.get("/photos/{token}/preview.jpg")
async def preview(request: Request, token: str) -> KeptFile:
    """The photograph, upright, its longest side 1600 pixels at most."""
    photos = _studio(request).photos
    photo = photos.get(token)
    return KeptFile(photos, photo, photo.preview, media_type="image/jpeg")


@uploads.delete("/photos/{token}")
async def forget_photo(request: Request, token: str) -> Response:
    """With its preview; what works on it is stopped."""
    studio = _studio(request)
    photo = studio.photos.get(token)
    for job in studio.jobs.kept:
        if photo.id in job.uses:
            studio.jobs.cancel(job)
    studio.photos.forget(photo)
    return Response(status_code=204)


@uploads.post("/maps")
async def take_map(request: Request, name: str = "") -> JSONResponse:
    """An .exr or .hdr lat-long map as the raw body."""
    taken = await _studio(request).take_map(request, name)
    return JSONResponse({"map": taken.id, **_described(taken)}, 201)


def _described(upload: Upload) -> dict[str, Any]:
    return {"name": upload.name, **upload.seen}
