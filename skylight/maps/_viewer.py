"""An estimate as one web page that opens from its file: photograph, light, heads and a model.

The page is given away, so of estimate.json it gets what :data:`SHOWN` names and nothing else; a
model of the user's own is checked before it goes in.
"""

import base64
import json
import os
import struct
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image

from skylight import __version__
from skylight.errors import InputError
from skylight.imaging._photo import read_photo
from skylight.io._atomic import atomic_path, require_place
from skylight.io._bounded import file_bytes, json_loads
from skylight.io._files import read_environment_map
from skylight.io._hdr import RGBE_MAX, rgbe_codes
from skylight.maps._estimated import (
    LARGEST,
    MAP,
    NUMBERS,
    head_file,
    picked,
    read_numbers,
    whole_sphere,
)
from skylight.transport._mesh import read_mesh

PAGE_BYTES_MAX = 3_000_000  # what mail takes everywhere
PHOTO_PX = 1280  # longest side
MAP_ROWS = 128  # an estimate has twice as many: a page takes a quarter of the bytes
MAP_BYTES_MAX = 2**26
_QUALITY = 85
_POSTERIOR = "posterior.exr"
# Built from studio/, where the script looks for this element.
_TEMPLATE = files("skylight.maps") / "data" / "viewer.html"
_PLACE = '<script type="application/json" id="estimate">'
_ANGLES = {"azimuth_deg": float, "zenith_deg": float}
_RGB = _XYZ = [float, float, float]
_CERTAINTY = {"word": str, "reason": str}
# Whatever is not named here stays out of the page: paths, time and place among it.
SHOWN = {
    "light": str,
    "choice": ({"probability": float}, None),
    "sun": _ANGLES,
    "lamps": [{**_ANGLES, "irradiance": _RGB, "spread_deg": float}],
    "verdict": {
        "light": str,
        "direction": _CERTAINTY,
        "brightness": _CERTAINTY,
        "colour": _CERTAINTY,
        "doubt": str,
    },
    "posterior": {
        "is_seen": bool,
        "share": float,
        "region_radius_deg": float,
        "region_edge_per_sr": float,
        "region_parts": [{**_ANGLES, "share": float}],
    },
    "advice": [str],
    "faces": [
        {"number": int, "residual": float, "albedo": _RGB, "eyes": _XYZ, "forward": _XYZ},
    ],
    "seconds": {str: float},
}
# What the page is made of besides.
SEEN = {
    "sources": [str],
    "faces": [
        {
            "source": str,
            "focal_length_px": float,
            "picture_px": [int, int],
            "exposure": float,
            "white_balance": _RGB,
            "edit": {"saturation": float, "contrast": float, "pivot": float},
        },
    ],
}
_VERTICES_MAX = 2**16
_STEPS = 2**15 - 1
SUFFIXES = (".glb", ".obj")
TRIANGLES_MAX = 500_000  # of all copies that its scene places
_JSON_CHUNK = 0x4E4F534A
# Their decoders are not in the page.
_PACKED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"}


@dataclass(frozen=True, kw_only=True)
class ExportedViewer:
    """Bytes of the page, and those of it that are photograph, light, heads and model."""

    size: int
    photo: int
    light: int
    heads: int
    model: int


def export_viewer(
    estimate: Path, out: Path, *, photo: Path | None = None, model: Path | None = None
) -> ExportedViewer:
    """Write a page that shows the results of ``skylight estimate`` in the folder ``estimate``.

    The page holds the viewer (``studio/src/viewer``), the photograph as a JPEG of at most 1280
    pixels a side, the fitted heads in it (:func:`stored_head`), the
    probe, where a sun or lamp was seen its posterior, and ``model``, a .glb or .obj that stands in
    the photograph first. Of estimate.json it holds what it shows
    (:data:`SHOWN`), of the photograph pixels and name alone.
    The composite is lit by the probe times the photograph's white balance and, where several share
    the light, its exposure over the first one's.

    Maps are stored as RGBE (:func:`~skylight.io._hdr.rgbe_codes`). So the irradiance of any surface
    differs in each channel from the probe's by at most ::

        |E_page(n) - E(n)| <= 1/256 sum_w max(L_R(w), L_G(w), L_B(w)) <n, w>+ dw

    Maps of more than 128 rows, which no estimate writes, are averaged to 128 first: the energy
    stays, the light moves by up to a degree, half a pixel's diagonal.

    ``photo`` is by default the first face's picture, where estimate.json says it is.

    Raises
    ------
    InputError
        No estimate of a face, no photograph or one of other proportions than the estimate's, a
        head, map or model that cannot be read, or more than 3 MB.
    OutputError
        ``out`` cannot be written; found out before the work where it can be.
    """
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: browsers open pages whose names end in .html; name it so")
    require_place(out)
    if not (estimate / NUMBERS).is_file():
        raise InputError(
            f"{estimate}: there is no {NUMBERS} in it; give a folder that skylight estimate wrote "
            "for a photograph"
        )
    path, numbers = read_numbers(estimate)
    try:
        result, known = picked(numbers, SHOWN, ""), picked(numbers, SEEN, "")
        seen = known["faces"]
        if not seen:
            raise ValueError('"faces" is empty')
        if not all(face["exposure"] > 1 / LARGEST for face in seen):
            raise ValueError('"exposure" is not above 0')
        if not all(face["source"].isprintable() for face in seen):
            raise ValueError('"source" is no file')
    except ValueError as error:
        raise InputError(
            f"{path}: {error}; the page shows estimates of faces, as this version "
            "writes them: estimate the photograph again"
        ) from error
    content = b"" if model is None else read_model(model, most=3 * PAGE_BYTES_MAX // 4)
    name, file = _photo_of(seen, photo, estimate)
    picture = read_photo(file).encoded
    first = next(face for face in seen if face["source"] == name)
    _require_proportions(picture, first["picture_px"], file)
    small = _small(picture)
    result["camera"] = {
        "focal_px": first["focal_length_px"] * small.width / first["picture_px"][0],
        "width": small.width,
        "height": small.height,
        "principal": [small.width / 2, small.height / 2],  # as heads are fitted
    }
    # the map is in the units of the first picture
    brighter = first["exposure"] / seen[0]["exposure"]
    result["white_balance"] = [brighter * gain for gain in first["white_balance"]]
    result["edit"] = first["edit"]
    heads = [
        stored_head(head_file(path, place, of=len(seen)), result["faces"][place]["eyes"])
        if face["source"] == name
        else None
        for place, face in enumerate(seen)
    ]
    result["advice"] = [_without_folders(line, known["sources"]) for line in result["advice"]]
    probe = _stored(estimate / MAP)
    posterior = _stored(estimate / _POSTERIOR) if result["posterior"]["is_seen"] else None
    jpeg = _base64(_jpeg(small))
    page = _page(
        {
            "version": __version__,
            "name": file.name,
            "photo": {"width": small.width, "height": small.height, "jpeg": jpeg},
            "probe": probe,
            "posterior": posterior,
            "heads": heads,
            "object": None if model is None else _named(model, content),
            "result": result,
        }
    )
    if len(page) > PAGE_BYTES_MAX:
        most = max(0.0, len(content) - 3 * (len(page) - PAGE_BYTES_MAX) / 4)
        remedy = (
            "give a smaller copy of the photograph by --photo"
            if model is None
            else f"simplify {model} to {most / 1e6:.1f} MB, or leave --object out"
        )
        raise InputError(
            f"the page would have {len(page) / 1e6:.1f} MB, more than the 3 MB that it may have: "
            + remedy
        )
    with atomic_path(out) as temporary:
        temporary.write_bytes(page)
    return ExportedViewer(
        size=len(page),
        photo=len(jpeg),
        light=sum(len(each["rgbe"]) for each in (probe, posterior) if each is not None),
        heads=sum(len(head["vertices"] + head["faces"]) for head in heads if head is not None),
        model=len(_base64(content)),
    )


def _page(data: dict[str, Any]) -> bytes:
    """The template with the data in it, as ASCII without "<": no text in them ends the element."""
    before, place, after = _TEMPLATE.read_text(encoding="utf-8").partition(_PLACE)
    assert place
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f"{before}{place}{text}{after}".encode()


def _photo_of(seen: list[dict[str, Any]], photo: Path | None, estimate: Path) -> tuple[str, Path]:
    """(what estimate.json calls the picture, its file)."""
    names = list(dict.fromkeys(face["source"] for face in seen))
    if photo is None:
        if not os.path.isfile(names[0]):  # Path's raises for names that cannot be
            raise InputError(
                f"{estimate}: its photograph {names[0]} is not there; say where it is with --photo"
            )
        return names[0], Path(names[0])
    named = names if len(names) == 1 else [n for n in names if Path(n).name == photo.name]
    if len(named) != 1:
        listed = ", ".join(Path(name).name for name in names)
        raise InputError(f"{photo}: the light is that of {listed}: name one of them with --photo")
    return named[0], photo


def _require_proportions(picture: UInt8[ndarray, "h w 3"], was: list[int], file: Path) -> None:
    height, width = picture.shape[:2]
    if min(was) < 1 or abs(width * was[1] / was[0] - height) > 1:
        raise InputError(
            f"{file}: {width}x{height} pixels, and the picture of the estimate had "
            f"{was[0]}x{was[1]}: give that picture, in any size, uncropped"
        )


def _small(picture: UInt8[ndarray, "h w 3"]) -> Image.Image:
    height, width = picture.shape[:2]
    scale = min(1.0, PHOTO_PX / max(height, width))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    return Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS)


def _jpeg(picture: Image.Image) -> bytes:
    """Made from pixels alone, so without the photograph's EXIF data."""
    buffer = BytesIO()
    picture.save(buffer, format="JPEG", quality=_QUALITY)
    return buffer.getvalue()


def _stored(path: Path) -> dict[str, Any]:
    """A map as the page decodes it."""
    if path.is_file() and (size := path.stat().st_size) > MAP_BYTES_MAX:
        raise InputError(
            f"{path}: {size} bytes are more than the {MAP_BYTES_MAX} that go into a page: make it "
            f"smaller by skylight convert --height {MAP_ROWS}"
        )
    light = whole_sphere(read_environment_map(path))
    if light.layout[0] > MAP_ROWS:
        light = light.resize(MAP_ROWS)
    radiance = light.radiance.numpy()
    if radiance.max() > RGBE_MAX:
        raise InputError(f"{path}: radiance of {radiance.max():.3g} is no light; repair it")
    height, width = light.layout
    return {"width": width, "height": height, "rgbe": _base64(rgbe_codes(radiance).tobytes())}


def _named(model: Path, content: bytes) -> dict[str, str]:
    return {"name": model.name, "content": _base64(content)}


def _without_folders(line: str, sources: list[str]) -> str:
    """A line of advice with pictures' names in place of their paths, which are private."""
    for source in sorted(sources, key=len, reverse=True):
        line = line.replace(source, Path(source).name)
    return line


def stored_head(path: Path, eyes: list[float]) -> dict[str, Any]:
    """A mesh as the page decodes it: v = eyes + ``scale`` * code, and the codes of 16 bits.

    ``eyes`` is in the mesh's units; ``scale`` is the farthest coordinate from there over 32767, so
    that each coordinate is off by half of it at most: for a head by 5 micrometres.
    """
    vertices, faces = (part.numpy() for part in read_mesh(path))
    if len(vertices) > _VERTICES_MAX:
        raise InputError(
            f"{path}: {len(vertices)} vertices are more than the {_VERTICES_MAX} of a head: "
            "estimate the photograph again"
        )
    apart = vertices - np.array(eyes)
    scale = float(np.abs(apart).max()) / _STEPS or 1.0
    return {
        "scale": scale,
        "vertices": _base64((apart / scale).round().astype("<i2").tobytes()),
        "faces": _base64(faces.astype("<u2").tobytes()),
    }


def read_model(path: Path, *, most: int) -> bytes:
    """The content of a .glb or .obj file of at most ``most`` bytes that the page can show."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: '{suffix}' is no model that the page reads: use .glb or .obj")
    try:
        content = file_bytes(path, most=most)
        if suffix == ".glb":
            _require_whole(content)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give another file") from error
    # readers of other people's scenes stumble over whatever is in there
    except (ValueError, struct.error, TypeError, AttributeError, KeyError, RecursionError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: the page cannot hold it ({reason})") from error
    triangles = len(read_mesh(path)[1])
    if triangles > TRIANGLES_MAX:
        raise InputError(
            f"{path}: {triangles} triangles are more than the {TRIANGLES_MAX} that the page draws: "
            "simplify it"
        )
    return content


def _require_whole(content: bytes) -> None:
    """ValueError, or whatever is raised by what is no scene, unless a .glb is all in itself."""
    magic, version, length = struct.unpack_from("<4sII", content)
    if magic != b"glTF" or version != 2:
        raise ValueError("it is no binary glTF 2.0")
    if length != len(content):
        raise ValueError(f"its header tells of {length} bytes, it has {len(content)}")
    chunks, at = [], 12
    while at < length:
        size, kind = struct.unpack_from("<II", content, at)
        if at + 8 + size > length:
            raise ValueError(f"a part of it tells of {size} bytes, {length - at - 8} are left")
        chunks.append((kind, content[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or chunks[0][0] != _JSON_CHUNK:
        raise ValueError("it has no scene")
    scene: Any = json_loads(chunks[0][1].decode("utf-8"))
    named = [entry.get("uri") for kind in ("buffers", "images") for entry in scene.get(kind, [])]
    if any(uri is not None and not uri.startswith("data:") for uri in named):
        raise ValueError("it names other files: pack buffers and textures into it")
    used = {*scene.get("extensionsUsed", []), *scene.get("extensionsRequired", [])} & _PACKED
    if used:
        raise ValueError(f"it is packed by {min(used)}: export it without compression")


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")
