"""Routes of uploads: photographs and environment maps."""

from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import JSONResponse

from skylight.studio.kept import KeptFile
from skylight.studio.state import Studio, Upload

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


@uploads.post("/maps")
async def take_map(request: Request, name: str = "") -> JSONResponse:
    """An .exr or .hdr lat-long map as the raw body."""
    taken = await _studio(request).take_map(request, name)
    return JSONResponse({"map": taken.id, **_described(taken)}, 201)


def _described(upload: Upload) -> dict[str, Any]:
    return {"name": upload.name, **upload.seen}
