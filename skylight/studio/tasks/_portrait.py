"""A person taken apart for a page that moves the sun: shading and transport, without the light.

The page adds, at each of the m points of the person's surface, to the shading S_0 and specular
reflection g_0 by all light but the sun's ::

    S = S_0 + E / pi V(d) <n, d>+,     g = g_0 + specular_scale E V(d) <n, d>+ f_s(n, d, v),

for a sun of irradiance E at d, and goes on as :mod:`skylight.portrait._relit` does. V(d) is
interpolated between the four nearest of 32 x 64 directions, so shadows have penumbras of 5.6
degrees.

Of every estimate is kept what its person can be taken apart from later, without estimating again
(:class:`KeptPerson`): fit, reflection and light are stored exactly, so the portrait is the one that
the estimate itself would have given.
"""

import json
import math
import shlex
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor
from torch.nn.functional import normalize

from skylight._names import LightName, Place
from skylight.estimation._summary import PhotoEstimate
from skylight.faces._fit import FaceFit
from skylight.faces._observe import SKIN_SPECULAR
from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._edits import Edit
from skylight.imaging._photo import Photo
from skylight.io._tensors import read_tensors, write_tensors
from skylight.portrait._files import KNEE, warning_of
from skylight.portrait._gain import BASE, BRIGHTER, DARKER, SHARP, SHINE, SOFT, TINT, TINTED
from skylight.portrait._lights import MovableSun
from skylight.portrait._relit import (
    FaceReflection,
    Portrait,
    coarse_power,
    light_in_photo,
    portrait_of,
)
from skylight.portrait._surface import scaled
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angles_from_direction
from skylight.studio.tasks._uploads import open_photo
from skylight.transport._cameras import Camera
from skylight.work._progress import StageProgress
from skylight.work._threads import cores

KEPT = "person.safetensors"
_OF_FIT = ("rotation", "translation", "identity", "expression", "vertices")


@dataclass(frozen=True, kw_only=True)
class KeptPerson:
    """The (first) face of an estimate; ``found`` and ``sun`` are in its photograph's units.

    ``facts`` are for the page: ``command``, the words of a command line up to its sun;
    ``is_alone``, whether the light is that of this face only; ``is_lamp``; ``was_found``;
    ``strength``, the sun's luminance as a multiple of the rest's on a horizontal surface, None
    where that is black; ``warning``.
    """

    fit: FaceFit
    reflection: FaceReflection
    found: EnvironmentMap
    sun: MovableSun
    facts: dict[str, Any]


def command_of(
    name: str,
    light: LightName,
    face: int | Literal["all"],
    model: str | None,
    network: str | None = None,
    place: Place = "auto",
) -> dict[str, Any]:
    """``command`` and ``is_alone`` of :class:`KeptPerson`."""
    words = ["skylight", "relight-portrait", name, "--light", light]
    words += [] if place == "auto" else ["--place", place]
    words += [] if face in (1, "all") else ["--face", str(face)]
    words += [] if model is None else ["--model", model]
    words += [] if network is None else ["--network", network]
    return {"command": shlex.join(words), "is_alone": face != "all"}


def keep_person(folder: Path, result: PhotoEstimate, command: dict[str, Any]) -> None:
    """Write what :func:`kept_person` reads."""
    fit, estimate = result.fit, result.estimate
    sun = MovableSun.of(estimate)
    reflection = FaceReflection.of(estimate, result.view.observation)
    tensors = {name: torch.from_numpy(getattr(fit, name)) for name in _OF_FIT}
    tensors |= {
        "camera": torch.tensor(
            [fit.camera.focal_px, fit.camera.width, fit.camera.height, *fit.camera.center_px],
            dtype=torch.float64,
        ),
        "found": light_in_photo(estimate).radiance,
        "rest": sun.rest.radiance,
        "direction": sun.direction.double(),
        "irradiance": sun.irradiance,
    }
    if fit.covariance is not None:
        tensors["covariance"] = torch.from_numpy(fit.covariance)
    if reflection.head_error is not None:
        tensors["head_error"] = reflection.head_error
    facts = command | {
        "is_lamp": bool(estimate.lamps),
        "was_found": sun.was_found,
        "strength": float(luminance(sun.irradiance)) / sun.level if sun.level > 0 else None,
        "level": sun.level,
        "spread_rad": sun.spread_rad,
        "gloss": reflection.specular_scale,
        "edit": asdict(reflection.edit),
        "landmark_error": fit.landmark_error,
        "converged": fit.converged,
        "warning": warning_of(estimate),
    }
    write_tensors(folder / KEPT, tensors, {"facts": json.dumps(facts)})


def kept_person(folder: Path) -> KeptPerson:
    """What :func:`keep_person` wrote."""
    tensors, metadata = read_tensors(folder / KEPT)
    facts = json.loads(metadata["facts"])
    focal_px, width, height, *center_px = tensors["camera"].tolist()
    camera = Camera(
        focal_px=focal_px,
        width=int(width),
        height=int(height),
        center_px=(center_px[0], center_px[1]),
    )
    covariance: Tensor | None = tensors.get("covariance")
    fit = FaceFit(
        camera=camera,
        landmark_error=facts.pop("landmark_error"),
        converged=facts.pop("converged"),
        covariance=None if covariance is None else covariance.numpy(),
        **{name: tensors[name].numpy() for name in _OF_FIT},
    )
    sun = MovableSun(
        direction=tensors["direction"],
        irradiance=tensors["irradiance"],
        rest=EnvironmentMap(radiance=tensors["rest"]),
        level=facts.pop("level"),
        spread_rad=facts.pop("spread_rad"),
        was_found=facts["was_found"],
    )
    return KeptPerson(
        fit=fit,
        reflection=FaceReflection(
            specular_scale=facts.pop("gloss"),
            head_error=tensors.get("head_error"),
            edit=Edit(**facts.pop("edit")),
        ),
        found=EnvironmentMap(radiance=tensors["found"]),
        sun=sun,
        facts=facts,
    )


FILE = "portrait.safetensors"
PIXELS = 1280 * 720  # of the picture
_MAP_ROWS = 64  # of the rest of the light, to be looked at
_UNSEEN = 1.5  # logarithm, the largest that is sent
_MARGIN = 46  # of the part of the shading that is sent, in its pixels: as far as it is blurred


def take_apart(
    path: str, name: str, pixels: int, estimate: str, folder: str, *, tell: StageProgress
) -> dict[str, Any]:
    """Write :data:`FILE`, of the estimate in the folder ``estimate``; nothing to tell."""
    tell("reading the picture", 0.0)
    person = kept_person(Path(estimate))
    photo, fit = _smaller(open_photo(Path(path), name, pixels), person.fit)
    tell("tracing light", 0.0)
    portrait = portrait_of(
        photo,
        fit,
        person.reflection,
        person.found,
        workers=cores(),
        progress=lambda share: tell("tracing light", share),
    )
    tell("writing the results", 0.0)
    tensors, facts = packed(portrait, person)
    write_tensors(Path(folder) / FILE, tensors, {"facts": json.dumps(facts)})
    return {}


def packed(portrait: Portrait, person: KeptPerson) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and numbers for the page, in the photograph's units.

    ``picture`` (h,w,4) has the photograph's sRGB codes, cut off at white, and its matte. ``crop``
    (left, top, width, height) is the part of the shading's picture, ``size`` (width, height), that
    holds person and surface; ``places`` (m,) are the points' in it. ``visible`` (m,256) has a bit
    for each of 32 x 64 directions, the lowest first. ``unseen`` (h,w) is that of
    :class:`~skylight.portrait._gain.Unseen`, from -:data:`_UNSEEN` to that in 255 steps.
    ``found_power`` and ``rest_power`` are
    :func:`~skylight.portrait._relit.coarse_power`; ``rest_map`` is to be looked at.
    """
    surface, sun = portrait.person.surface, person.sun
    rest_shading, rest_specular = portrait.shaded_by(sun.rest)
    rows, columns = np.nonzero(portrait.on.covered)  # row by row, as the surface has them
    left, top, width, height = _crop(portrait)
    codes = (linear_to_srgb(torch.from_numpy(portrait.photo).clamp(0, 1)) * 255).round()
    matte = torch.from_numpy(portrait.matte * 255).round()
    irradiance = sun.irradiance
    if portrait.grey:
        irradiance = luminance(irradiance).expand(3)
    azimuth, zenith = angles_from_direction(sun.direction)
    of_points = {
        "shading": portrait.shading,
        "glossy": portrait.specular,
        "rest_shading": rest_shading,
        "rest_glossy": rest_specular,
        "unseen_tint": portrait.unseen.colour,
        "skin_tint": portrait.unseen.skin,
        "bare": portrait.on.bare,
        "known": portrait.known,
    }
    steps = 127.5 * (portrait.unseen.level / _UNSEEN + 1)
    tensors = {
        "picture": torch.cat([codes, matte[..., None]], 2).to(torch.uint8),
        "unseen": torch.from_numpy(steps.round().clip(0, 255)).to(torch.uint8),
        "places": torch.from_numpy((rows - top) * width + columns - left).int(),
        "normals": portrait.person.normals.float(),
        "views": -normalize(surface.positions, dim=1).float(),
        "visible": _bits(portrait.person.sight.visible),
        "found_power": coarse_power(portrait.found).float(),
        "rest_power": coarse_power(sun.rest).float(),
        "rest_map": sun.rest.resize(min(_MAP_ROWS, sun.rest.layout[0])).radiance,
    }
    tensors |= {
        name: torch.from_numpy(image[rows, columns]).float() for name, image in of_points.items()
    }
    facts = person.facts | {
        "doubts": list(portrait.doubts),
        "size": portrait.on.covered.shape[::-1],
        "crop": [left, top, width, height],
        "sun": {"azimuth_deg": math.degrees(azimuth), "zenith_deg": math.degrees(zenith)},
        "irradiance": irradiance.tolist(),
        "map_rows": sun.rest.layout[0],
        "gloss": portrait.specular_scale,
        "lobe": {"f0": SKIN_SPECULAR.f0, "alpha": SKIN_SPECULAR.alpha},
        "sigmas_px": [x * portrait.on.face_px for x in (SHARP, SOFT, TINT)],
        "base": BASE,
        "shine": SHINE / portrait.albedo,
        "most": [BRIGHTER, DARKER],
        "tinted": TINTED,
        "unseen": _UNSEEN,
        "doubted": portrait.strength,
        "knee": KNEE,
        "edit": asdict(portrait.edit),
    }
    return tensors, facts


def _bits(visible: Tensor) -> UInt8[Tensor, "m b"]:
    return torch.from_numpy(np.packbits(visible.numpy(), axis=1, bitorder="little"))


def _crop(portrait: Portrait) -> tuple[int, int, int, int]:
    """(left, top, width, height) of what holds surface and matte, with a margin."""
    shown = cv2.resize(
        portrait.matte, portrait.on.covered.shape[::-1], interpolation=cv2.INTER_AREA
    )
    inside = (shown > 0) | (portrait.on.covered > 0)
    ends: list[tuple[int, int]] = []
    for axis in (0, 1):
        (along,) = np.nonzero(inside.any(axis))
        first = max(0, int(along[0]) - _MARGIN)
        ends.append((first, min(inside.shape[1 - axis], int(along[-1]) + 1 + _MARGIN) - first))
    (left, width), (top, height) = ends
    return left, top, width, height


def _smaller(photo: Photo, fit: FaceFit) -> tuple[Photo, FaceFit]:
    """With :data:`PIXELS` at most."""
    height, width = photo.encoded.shape[:2]
    scale = math.sqrt(PIXELS / (height * width))
    if scale >= 1:
        return photo, fit
    camera = scaled(fit.camera, scale)

    def resized(picture: Any) -> Any:
        return cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)

    small = replace(
        photo,
        pixels=torch.from_numpy(resized(photo.pixels.numpy())),
        encoded=resized(photo.encoded),
        clipped=torch.from_numpy(resized(photo.clipped.numpy().astype(np.float32)) > 0),
    )
    return small, replace(fit, camera=camera)
