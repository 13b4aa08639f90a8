"""A person taken apart for a page that moves the key light: shading and transport, without light.

The page adds, at each of the m points of the person's surface and in luminance, the shading S_0
and specular reflection g_0 by the fill R, those (S_L, g_L) by the light found L, and a key light's
of lobe g(w) towards d, of which a share b is behind the sitter ::

    S = f ((1 - b) S_0 + b B(R) / B(L) S_L) + E / pi T,    T = sum_w g(w) V(w) <n, w>+ dw,
    g = f ((1 - b) g_0 + b B(R) / B(L) g_L) + specular_scale E T f_s(n, d, v),
    E = (1 - b) f s B(R).

f, s and B are those of :mod:`skylight.portrait._keys`, b is
:func:`skylight.portrait._edge.edge_share`, which is drawn as an edge of strength
``RIM b s / (1 + s m)``, m being what the key counts for in an exposure, and f_s is as much rougher
as the lobe is wide. The page goes on as :mod:`skylight.portrait._relit` does. V is that of 32 x 64
directions, so no shadow has a penumbra of less than 5.6 degrees.

Of every estimate is kept what its person can be taken apart from later, without estimating again
(:mod:`skylight.estimation._kept`).
"""

import json
import math
import shlex
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import normalize

from skylight._names import LightName, Place
from skylight.estimation._kept import KeptFace, read_face, write_face
from skylight.estimation._summary import PhotoEstimate
from skylight.faces._fit import FaceFit
from skylight.faces._observe import SKIN_SPECULAR
from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._photo import Photo
from skylight.io._bounded import json_content, write_json
from skylight.io._tensors import write_tensors
from skylight.portrait._bounce import ALBEDO, AROUND
from skylight.portrait._edge import (
    BEHIND,
    BODY,
    HAIR_BODY,
    METERED,
    MOST_STRAND,
    SOON_LIT,
    lamp_colour,
)
from skylight.portrait._files import KNEE
from skylight.portrait._gain import (
    BASE,
    BRIGHTER,
    DARKER,
    DARKEST,
    EDGE_OF_WHITE,
    KNEE as GAIN_KNEE,
    LUMINANCE_WEIGHTS,
    NEAR,
    REACH,
    SHARP,
    SHINE,
    SOON,
)
from skylight.portrait._keys import (
    KEY_OVER_FILL,
    KEYS,
    RIM,
    USUAL_DEG,
    brightness_of_ball,
    fill_of,
)
from skylight.portrait._relit import (
    Portrait,
    coarse_power,
    light_in_photo,
    portrait_of,
)
from skylight.portrait._room import BEGINS, OTHER_BRIGHTER, OTHER_DARKER, OVER, ROUND
from skylight.portrait._surface import PersonSurface, scaled
from skylight.studio.tasks._uploads import open_photo
from skylight.work._progress import StageProgress
from skylight.work._threads import cores

COMMAND = "command.json"  # what :func:`command_of` tells


def command_of(
    name: str,
    light: LightName,
    face: int | Literal["all"],
    model: str | None,
    network: str | None = None,
    place: Place = "auto",
) -> dict[str, Any]:
    """``command``, the words of a command line up to its light, and ``is_alone``, whether the
    light is that of this face only."""
    words = ["skylight", "relight-portrait", name, "--light", light]
    words += [] if place == "auto" else ["--place", place]
    words += [] if face in (1, "all") else ["--face", str(face)]
    words += [] if model is None else ["--model", model]
    words += [] if network is None else ["--network", network]
    return {"command": shlex.join(words), "is_alone": face != "all"}


def keep_person(folder: Path, result: PhotoEstimate, command: dict[str, Any]) -> None:
    """Write what :func:`take_apart` goes on from."""
    write_face(folder, KeptFace.of(result))
    write_json(folder / COMMAND, command)


FILE = "portrait.safetensors"
PIXELS = 1280 * 720  # of the picture
_MAP_ROWS = 64  # of the light found, to be looked at
_UNSEEN = 1.5  # logarithm, the largest that is sent
_MARGIN = 46  # of the part of the shading that is sent, in its pixels: as far as it is blurred


def take_apart(
    path: str, name: str, pixels: int, estimate: str, folder: str, *, tell: StageProgress
) -> dict[str, Any]:
    """Write :data:`FILE`, of the estimate in the folder ``estimate``; nothing to tell."""
    tell("reading the picture", 0.0)
    face = read_face(Path(estimate), open_photo(Path(path), name, pixels))
    photo, fit = _smaller(face.photo, face.fit)
    tell("tracing light", 0.0)
    portrait = portrait_of(
        photo,
        fit,
        face.reflection,
        light_in_photo(face),
        workers=cores(),
        progress=lambda share: tell("tracing light", share),
    )
    tell("writing the results", 0.0)
    tensors, facts = packed(portrait, face)
    facts |= json_content(Path(estimate) / COMMAND)
    write_tensors(Path(folder) / FILE, tensors, {"facts": json.dumps(facts)})
    return {}


def packed(portrait: Portrait, face: KeptFace) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and numbers for the page, in the photograph's units.

    ``picture`` (h,w,4) has the photograph's sRGB codes, cut off at white, and its matte; ``crop``
    (left, top, width, height) is the part of the shading's picture, ``size`` (width, height), that
    holds person and surface; ``places`` (m,) are the skin's points in it. ``visible`` (m,256) has
    a bit for each of 32 x 64 directions, the lowest first. ``marks`` (h,w,3) are U of
    :class:`~skylight.portrait._gain.Unseen`, from -:data:`_UNSEEN` to that in 255 steps, and
    :func:`~skylight.portrait._room.base_of` from ``ln DARKEST`` to 0, how much shows skin, and how
    far the picture tells the person from what is behind.
    ``found_power`` is
    :func:`~skylight.portrait._relit.coarse_power`; ``found_map`` is to be looked at. ``occlusion``
    and ``fill_gloss`` are S_0 and g_0 in luminance, over ``fill``, which is how bright the fill R
    of :mod:`skylight.portrait._keys` makes the ball, as ``ball`` is how bright the light found
    does. ``shading`` and ``glossy`` (m,3) are S_L and g_L, in colour.
    ``share`` is :meth:`~skylight.portrait._gain.Surface.share` of the crop, ``outline`` how its
    outline leans (:mod:`skylight.portrait._edge`), how far it has the colour of skin and how bright
    the person is around, ``reflecting`` what is lit from behind, ``pale`` that and ``astray``
    of :class:`~skylight.portrait._gain.SkinColour`. ``hue`` and ``albedo`` are of
    :mod:`skylight.portrait._bounce`.
    """
    person = portrait.person
    assert isinstance(person, PersonSurface)  # a photograph's, traced at its own pixels
    fill = fill_of(portrait.found)
    level = brightness_of_ball(fill)
    fill_shading, fill_specular = (
        image @ LUMINANCE_WEIGHTS / np.float32(level) for image in portrait.shaded_by(fill)
    )
    rows, columns = person.surface.pixels[person.skin].numpy().T
    left, top, width, height = _crop(portrait)
    outline = portrait.outline
    red, green, blue = portrait.found.integrate().double().tolist()
    lamp = (1.0, 1.0, 1.0) if portrait.grey else lamp_colour((red, green, blue))

    def within(image: Float[ndarray, "p q *c"]) -> Float[ndarray, "k l *c"]:
        return np.ascontiguousarray(image[top : top + height, left : left + width])

    codes = (linear_to_srgb(torch.from_numpy(portrait.photo).clamp(0, 1)) * 255).round()
    matte = torch.from_numpy(portrait.matte * 255).round()
    of_points = {
        "shading": portrait.shading,
        "glossy": portrait.specular,
        "occlusion": fill_shading,
        "fill_gloss": fill_specular,
        "bare": portrait.on.bare,
        "face": portrait.on.face,
    }
    marks = np.dstack(
        [
            127.5 * (portrait.unseen.level / _UNSEEN + 1),
            255 * (1 - portrait.base / math.log(DARKEST)),
            255 * portrait.skin,
            255 * outline.sure,
        ]
    )
    tensors = {
        "picture": torch.cat([codes, matte[..., None]], 2).to(torch.uint8),
        "marks": torch.from_numpy(marks.round().clip(0, 255)).to(torch.uint8),
        "share": torch.from_numpy(within(portrait.on.share())),
        "outline": torch.from_numpy(
            within(np.dstack([outline.leaning, portrait.colour.alike, outline.around]))
        ),
        "reflecting": torch.from_numpy(
            within(np.dstack([outline.surface, outline.hair, outline.gloss]))
        ),
        "pale": torch.from_numpy(within(np.dstack([portrait.colour.pale, portrait.colour.astray]))),
        "places": torch.from_numpy((rows - top) * width + columns - left).int(),
        "normals": person.normals.float(),
        "views": -normalize(person.surface.positions[person.skin], dim=1).float(),
        "visible": _bits(person.sight.visible),
        "found_power": coarse_power(portrait.found).float(),
        "found_map": portrait.found.resize(min(_MAP_ROWS, portrait.found.layout[0])).radiance,
    }
    tensors |= {
        name: torch.from_numpy(image[rows, columns]).float() for name, image in of_points.items()
    }
    facts = {
        "warning": face.warning,
        "doubts": list(portrait.doubts),
        "size": portrait.on.traced.shape[::-1],
        "crop": [left, top, width, height],
        "keys": dict(KEYS),
        "usual": {"size_deg": USUAL_DEG, "strength": KEY_OVER_FILL},
        "fill": level,
        "ball": brightness_of_ball(portrait.found),
        "gloss": portrait.specular_scale,
        "lobe": {"f0": SKIN_SPECULAR.f0, "alpha": SKIN_SPECULAR.alpha},
        "sigmas_px": [x * portrait.on.face_px for x in (SHARP, REACH, AROUND)],
        "near": NEAR,
        "albedo": ALBEDO,
        "hue": portrait.hue.tolist(),
        "base": BASE,
        "shine": SHINE / portrait.albedo,
        "most": [BRIGHTER, DARKER],
        "darkest": math.log(DARKEST),
        "veil": portrait.veil,
        "room": [BEGINS, ROUND],
        "bend": GAIN_KNEE,
        "edge_of_white": EDGE_OF_WHITE,
        "over": OVER,
        "other_most": [OTHER_BRIGHTER, OTHER_DARKER],
        "lacks": portrait.colour.lacks.tolist(),
        "soon": SOON,
        "behind": BEHIND,
        "metered": METERED,
        "rim": RIM,
        "lamp_shine": lamp,
        "lit": portrait.lit,
        "stray": portrait.stray,
        "most_strand": MOST_STRAND,
        "sent": [BODY, HAIR_BODY],
        "soon_lit": SOON_LIT,
        "across": portrait.colour.across.tolist(),
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
    shown = cv2.resize(portrait.matte, portrait.on.traced.shape[::-1], interpolation=cv2.INTER_AREA)
    inside = (shown > 0) | (portrait.on.traced > 0)
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
