"""The light of an uploaded photograph, and its faces and map under lamps that a page has edited.

Beside an estimate's files is kept what its lamps light: transport, albedo and picture of each face
(:func:`keep_lamps`), so that moving and switching them (:func:`light_edited`) estimates nothing.
"""

import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from skylight._figures import white_of
from skylight._names import LightName, Place
from skylight.estimation._kept import kept_lamps, lamp_tensors
from skylight.estimation._photos import estimate_photo
from skylight.estimation._report import over_grey, write_results
from skylight.estimation._summary import PhotoEstimate
from skylight.imaging._colour import tone_map
from skylight.imaging._edits import Edit
from skylight.inverse._lamp_relighting import FaceTransport, LampLight
from skylight.inverse._result import MAP_ROWS
from skylight.io._files import write_environment_map, write_png
from skylight.io._tensors import read_tensors, write_tensors
from skylight.models._bundle import load_model, own_model
from skylight.models._sphere import Places
from skylight.relight._lamps import disc_diameter_rad
from skylight.sphere._frame import direction_from_angles
from skylight.studio.tasks._portrait import command_of, keep_person
from skylight.studio.tasks._uploads import open_photo, preview_scale
from skylight.work._progress import StageProgress

KEPT = "lamps.safetensors"
FACES = "face.png"
_IN_MEMORY = 2  # estimates: with a face of 2,500 pixels each takes 10 MB


def estimate_light(
    path: str,
    name: str,
    pixels: int,
    folder: str,
    face: int | Literal["all"],
    light: LightName,
    model: str | None = None,
    network: str | None = None,
    place: Place = "auto",
    *,
    tell: StageProgress,
) -> dict[str, Any]:
    """estimate.json with the preview's camera; all files in ``folder``.

    With lamps also how wide these are, and the ambient light's irradiance.
    """
    tell("reading the picture", 0.0)
    photo = open_photo(Path(path), name, pixels)
    chosen = own_model(None if model is None else Path(model), network)
    # the light alone, which a page moves and switches
    result = estimate_photo(
        photo,
        names=[name],
        light=light,
        model=chosen,
        place=place,
        face=face,
        detail="none",
        progress=tell,
    )
    tell("writing the results", 0.0)
    write_results(Path(folder), result)
    # beside the folder, as the page offers all files in it
    keep_person(Path(folder).parent, result, command_of(name, light, face, model, network, place))
    described = json.loads((Path(folder) / "estimate.json").read_text(encoding="utf-8"))
    if result.estimate.lamps:
        own = None if chosen is None else load_model(chosen)
        lit = LampLight.of(result.estimate, own if isinstance(own, Places) else None)
        described["lamp_facts"] = keep_lamps(Path(folder).parent, result, lit)
    return described | {"camera": _preview_camera(result, preview_scale(photo))}


def _preview_camera(result: PhotoEstimate, scale: float) -> dict[str, Any]:
    """That of the first head's fit, for the preview."""
    camera = result.fit.camera
    return {
        "focal_px": scale * camera.focal_px,
        "width": round(scale * camera.width),
        "height": round(scale * camera.height),
        "principal": [scale * part for part in camera.center_px],
    }


@dataclass(frozen=True, kw_only=True)
class _Face:
    """A face and its picture, shown with the luminance ``white`` as white."""

    transport: FaceTransport
    image: Float[Tensor, "h w 3"]
    places: Int[Tensor, "u 2"]
    blocks: Int[Tensor, " u"]
    white: float

    def panels(self, light: LampLight) -> list[UInt8[np.ndarray, "h w 3"]]:
        """As it was seen, and under the light."""
        rendered = self.transport.rendered(light)[self.blocks]
        rendered = over_grey(self.image, self.places, rendered)
        return [tone_map(picture, white=self.white) for picture in (self.image, rendered)]


def keep_lamps(folder: Path, result: PhotoEstimate, light: LampLight) -> dict[str, Any]:
    """Write what :func:`light_edited` needs; what the page's table has beside estimate.json.

    ``diameters_deg`` are those of discs that are as wide as the lamps.
    """
    tensors = {
        **{f"ambient.{rows}": radiance for rows, radiance in light.ambient.items()},
        "level": torch.tensor(light.level, dtype=torch.float64),
        **lamp_tensors(light.lamps),
        "spreads_rad": torch.tensor([lamp.spread_rad for lamp in light.lamps]).double(),
    }
    for number, (seen, face) in enumerate(zip(result.seen, result.estimate.faces, strict=True)):
        observation = seen.view.observation
        transport = FaceTransport.of(observation, face, light.level)
        kept = {
            "matt": transport.diffuse,
            "pixel_albedo": transport.pixel_albedo,
            "gains": transport.gains,
            "grey": torch.tensor(transport.grey),
            "edit": torch.tensor(astuple(transport.edit), dtype=torch.float64),
            "image": seen.view.image,
            "places": seen.view.places,
            "blocks": seen.view.blocks,
            "white": torch.tensor(white_of(observation.pixels), dtype=torch.float64),
        }
        if transport.specular is not None:
            kept["glossy"] = transport.specular
        tensors |= {f"{number}.{name}": tensor for name, tensor in kept.items()}
    write_tensors(folder / KEPT, tensors)
    return {
        "ambient_irradiance": light.ambient_irradiance().tolist(),
        "diameters_deg": [
            float(np.rad2deg(disc_diameter_rad(lamp.spread_rad))) for lamp in light.lamps
        ],
    }


def light_edited(
    folder: str,
    file: str,
    azimuth_deg: list[float],
    zenith_deg: list[float],
    on: list[bool],
    ambient: bool,
    *,
    tell: StageProgress,
) -> dict[str, Any]:
    """The content of a file under edited lamps, base64: :data:`FACES`, or the map as .exr or .hdr.

    Lamps keep their irradiance and width wherever they are moved.
    """
    tell("lighting the face", 0.0)
    found, faces = _kept(folder)
    angles = torch.tensor([azimuth_deg, zenith_deg], dtype=torch.float64).deg2rad().T
    moved = tuple(
        replace(lamp, direction=direction_from_angles(*towards))
        for lamp, towards, is_on in zip(found.lamps, angles, on, strict=True)
        if is_on
    )
    light = replace(found, lamps=moved, level=found.level if ambient else 0.0)
    with TemporaryDirectory(dir=folder) as temporary:
        path = Path(temporary) / file
        if file == FACES:
            seen_and_rendered = zip(*(face.panels(light) for face in faces), strict=True)
            write_png(path, np.hstack([_column(panels) for panels in seen_and_rendered]))
        else:
            write_environment_map(path, light.environment(MAP_ROWS))
        return {"content": b64encode(path.read_bytes()).decode()}


@lru_cache(maxsize=_IN_MEMORY)
def _kept(folder: str) -> tuple[LampLight, list[_Face]]:
    """What :func:`keep_lamps` wrote; it does not change."""
    tensors, _ = read_tensors(Path(folder) / KEPT)
    lamps = kept_lamps(tensors, tensors["spreads_rad"].tolist())
    ambient = {
        int(name.removeprefix("ambient.")): tensor
        for name, tensor in tensors.items()
        if name.startswith("ambient.")
    }
    light = LampLight(ambient=ambient, level=float(tensors["level"]), lamps=lamps)
    faces: list[_Face] = []
    while f"{len(faces)}.matt" in tensors:
        start = f"{len(faces)}."
        mine = {
            name.removeprefix(start): tensor
            for name, tensor in tensors.items()
            if name.startswith(start)
        }
        saturation, contrast, pivot = mine["edit"].tolist()
        transport = FaceTransport(
            diffuse=mine["matt"],
            specular=mine.get("glossy"),
            pixel_albedo=mine["pixel_albedo"],
            gains=mine["gains"],
            grey=bool(mine["grey"]),
            edit=Edit(saturation=saturation, contrast=contrast, pivot=pivot),
        )
        white = float(mine["white"])
        shown = {name: mine[name] for name in ("image", "places", "blocks")}
        faces.append(_Face(transport=transport, white=white, **shown))
    return light, faces


def _column(pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> UInt8[np.ndarray, "h w 3"]:
    """Below each other, black beside the narrower ones."""
    width = max(picture.shape[1] for picture in pictures)
    return np.vstack([np.pad(p, ((0, 0), (0, width - p.shape[1]), (0, 0))) for p in pictures])
