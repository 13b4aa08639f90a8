"""Illumination from an uploaded photograph.

An estimate's faces and map under its lamps as a page has moved and switched them.

The environment map of a job: an upload, or the result of an estimate.

Principal axes of the sky latents, for the sliders of the page.

The prior is a mixture over whitened latents x; the decoder takes latents z = S x + m, with the
lower triangular ``latent_scale`` S and ``latent_mean`` m of the light model. By the law of total
covariance, of the mixture with weights w_k, means mu_k and covariances C_k,

    E[x] = sum_k w_k mu_k,   cov x = sum_k w_k (C_k + mu_k mu_k^T) - E[x] E[x]^T,
    E[z] = S E[x] + m,       cov z = S cov(x) S^T,

and the components are the eigenvectors of cov z with the largest eigenvalues. The azimuth is no
latent: the decoder's sun is in the centre, and the page turns the map.
"""

import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, TypedDict

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from skylight._figures import white_of
from skylight.estimate._photos import estimate_photo
from skylight.estimate._report import over_grey, write_results
from skylight.estimate._summary import PhotoEstimate
from skylight.imaging._colour import tone_map
from skylight.inverse._lamp_relighting import FaceTransport, LampLight
from skylight.inverse._lamps import MAP_ROWS
from skylight.inverse._result import Lamp
from skylight.io._files import read_environment_map, write_environment_map, write_png
from skylight.io._tensors import read_tensors, write_tensors
from skylight.models._bundle import load_bundle
from skylight.models._names import LightName
from skylight.models._network import HEIGHT, WIDTH
from skylight.models._prior import GaussianMixture
from skylight.models.autoencoder import AutoencoderLight
from skylight.relight._lamps import disc_diameter_rad
from skylight.relight._runtime import GROUND_ALBEDO
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import direction_from_angles
from skylight.studio.tasks._portrait import command_of, keep_person
from skylight.studio.tasks._uploads import named, open_photo, preview_scale
from skylight.work._progress import StageProgress

KEPT = "lamps.safetensors"
FACES = "face.png"
_IN_MEMORY = 2  # estimates: with a face of 2,500 pixels each takes 10 MB


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


def keep_lamps(folder: Path, result: PhotoEstimate) -> dict[str, Any]:
    """Write what :func:`light_edited` needs; what the page's table has beside estimate.json.

    ``diameters_deg`` are those of discs that are as wide as the lamps.
    """
    light = LampLight.of(result.estimate)
    tensors = {
        "ambient": light.ambient,
        "level": torch.tensor(light.level, dtype=torch.float64),
        "directions": torch.stack([lamp.direction for lamp in light.lamps]),
        "irradiances": torch.stack([lamp.irradiance for lamp in light.lamps]),
        "spreads_rad": torch.tensor([lamp.spread_rad for lamp in light.lamps]).double(),
    }
    for number, (seen, face) in enumerate(zip(result.seen, result.estimate.faces, strict=True)):
        observation = seen.view.observation
        transport = FaceTransport.of(observation, face, light.level)
        kept = {
            "matt": transport.matt,
            "pixel_albedo": transport.pixel_albedo,
            "gains": transport.gains,
            "grey": torch.tensor(transport.grey),
            "image": seen.view.image,
            "places": seen.view.places,
            "blocks": seen.view.blocks,
            "white": torch.tensor(white_of(observation.pixels), dtype=torch.float64),
        }
        if transport.glossy is not None:
            kept["glossy"] = transport.glossy
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
    rows = (tensors[name] for name in ("directions", "irradiances", "spreads_rad"))
    lamps = tuple(
        Lamp(direction=direction, irradiance=irradiance, spread_rad=float(spread_rad))
        for direction, irradiance, spread_rad in zip(*rows, strict=True)
    )
    light = LampLight(ambient=tensors["ambient"], level=float(tensors["level"]), lamps=lamps)
    faces: list[_Face] = []
    while f"{len(faces)}.matt" in tensors:
        start = f"{len(faces)}."
        mine = {
            name.removeprefix(start): tensor
            for name, tensor in tensors.items()
            if name.startswith(start)
        }
        transport = FaceTransport(
            matt=mine["matt"],
            glossy=mine.get("glossy"),
            pixel_albedo=mine["pixel_albedo"],
            gains=mine["gains"],
            grey=bool(mine["grey"]),
        )
        white = float(mine["white"])
        shown = {name: mine[name] for name in ("image", "places", "blocks")}
        faces.append(_Face(transport=transport, white=white, **shown))
    return light, faces


def _column(pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> UInt8[np.ndarray, "h w 3"]:
    """Below each other, black beside the narrower ones."""
    width = max(picture.shape[1] for picture in pictures)
    return np.vstack([np.pad(p, ((0, 0), (0, width - p.shape[1]), (0, 0))) for p in pictures])


def estimate_light(
    path: str,
    name: str,
    pixels: int,
    folder: str,
    face: int | Literal["all"],
    light: LightName,
    model: str | None = None,
    *,
    tell: StageProgress,
) -> dict[str, Any]:
    """estimate.json with the preview's camera; all files in ``folder``.

    With lamps also how wide these are, and the ambient light's irradiance.
    """
    tell("reading the picture", 0.0)
    photo = open_photo(Path(path), name, pixels)
    result = estimate_photo(photo, names=[name], light=light, model=model, face=face, progress=tell)
    tell("writing the results", 0.0)
    write_results(Path(folder), result)
    # beside the folder, as the page offers all files in it
    keep_person(Path(folder).parent, result, command_of(name, light, face, model))
    described = json.loads((Path(folder) / "estimate.json").read_text(encoding="utf-8"))
    if result.estimate.lamps:
        described["lamp_facts"] = keep_lamps(Path(folder).parent, result)
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


class Light(TypedDict):
    """Where its file is, and what the user calls it."""

    path: str
    name: str


def read_light(light: Light) -> EnvironmentMap:
    """The map of the whole sphere."""
    path = Path(light["path"])
    with named(path, light["name"]):
        return read_environment_map(path)


COMPONENTS = 8


def latent_moments(
    light: AutoencoderLight, prior: GaussianMixture
) -> tuple[Float[Tensor, " z"], Float[Tensor, "z z"]]:
    """(mean, covariance) of the decoder's latents under a mixture over whitened ones."""
    weights, means = prior.weights.double(), prior.means.double()
    factors = prior.precision_factors.double()
    covariances = torch.linalg.inv(factors @ factors.mT)
    mean = weights @ means
    second = covariances + means[:, :, None] * means[:, None, :]
    covariance = torch.einsum("k,kpq->pq", weights, second) - torch.outer(mean, mean)
    scale = light.latent_scale.double()
    return scale @ mean + light.latent_mean.double(), scale @ covariance @ scale.T


def describe_sky(*, tell: StageProgress) -> dict[str, Any]:
    """The mean latent and the main components with their standard deviations.

    ``components`` (8, 64) are unit vectors among the decoder's latents, so that
    ``mean + sum_i a_i sigmas_i components_i`` with a_i from -2 to 2 are likely skies. ``shares``
    are those of the trace of the covariance. A component's sign is arbitrary; here its largest
    entry is positive.
    """
    tell("finding the main components", 0.0)
    bundle = load_bundle()
    mean, covariance = latent_moments(bundle.light(), bundle.latent_prior)
    variances, axes = torch.linalg.eigh(covariance)
    variances, axes = variances.flip(0)[:COMPONENTS], axes.flip(1).T[:COMPONENTS]
    largest = axes.gather(1, axes.abs().argmax(1, keepdim=True))
    return {
        "components": (axes * largest.sign()).tolist(),
        "sigmas": variances.sqrt().tolist(),
        "mean": mean.tolist(),
        "shares": (variances / covariance.trace()).tolist(),
        "ground_albedo": [GROUND_ALBEDO] * 3,
        "rows": HEIGHT,
        "columns": WIDTH,
    }
