"""The files of an estimate: maps, meshes, numbers, and the report that shows it all.

The report of one face has the photograph, the head framed, the face re-rendered, the residual, the
light and the numbers; that of several faces a row for each.
"""

import json
import math
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from textwrap import TextWrapper

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from skylight._figures import (
    ACCENT,
    MUTED,
    SCENE_GRID,
    SCENE_HEIGHT,
    angles_deg,
    relit,
    white_of,
)
from skylight.estimation._kept import KeptFace, write_face
from skylight.estimation._page import SMALL, TITLE, Page, Panel
from skylight.estimation._summary import (
    REGION,
    PhotoEstimate,
    describe,
    has_ground,
    main_light,
    posterior_map,
    probe_title,
    region_lines,
)
from skylight.faces._fit import FaceFit
from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import HeadModel
from skylight.faces._observe import FaceView
from skylight.imaging._colour import tone_map
from skylight.imaging._photo import Photo
from skylight.imaging._preview import write_probe
from skylight.inverse._verdict import place
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import pixel_from_direction
from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize
from skylight.transport._scene import evaluation_scene

RESIDUAL_LIMIT = 0.5
NOTHING = (236, 239, 242)
# ColorBrewer's RdBu of 11 classes (Harrower & Brewer 2003), turned round
BLUE_TO_RED = np.array(
    [
        (5, 48, 97),
        (33, 102, 172),
        (67, 147, 195),
        (146, 197, 222),
        (209, 229, 240),
        (247, 247, 247),
        (253, 219, 199),
        (244, 165, 130),
        (214, 96, 77),
        (178, 24, 43),
        (103, 0, 31),
    ]
)
LIGHTS = {
    "sphere": "light model: any place, all round (sphere)",
    "autoencoder": "light model: learnt skies (autoencoder)",
    "sunsky": "light model: sun and Preetham sky",
    "lamps": "light model: lamps in ambient light",
    "sh9": "light model: 9 spherical harmonics",
    "sh25": "light model: 25 spherical harmonics",
}


def light_in_words(name: str) -> str:
    """A light model as reports name it: the user's own by its name."""
    return LIGHTS.get(name, f"light model: {name}")


def head_window(photo: Photo, face: DetectedFace) -> tuple[np.ndarray, np.ndarray]:
    """(left, top) and (right, bottom) in pixels around the head's front, within the picture."""
    points = face.points
    margin = 0.5 * np.ptp(points, axis=0).max()
    height, width = photo.encoded.shape[:2]
    low = np.clip(points.min(0) - margin * np.array([1.0, 1.2]), 0, None)
    high = np.minimum(points.max(0) + margin * np.array([1.0, 0.6]), [width, height])
    return np.floor(low).astype(int), np.ceil(high).astype(int)


def over_grey(
    image: Float[Tensor, "h w 3"], places: Int[Tensor, "u 2"], rendered: Float[Tensor, "u 3"]
) -> Float[Tensor, "h w 3"]:
    """A re-rendered face at its places in its picture, which is dimmed and grey."""
    picture = (0.35 * luminance(image))[..., None].repeat(1, 1, 3)
    rows, columns = places.unbind(1)
    picture[rows, columns] = rendered.to(picture)
    return picture


def residual_codes(view: FaceView, rendered: Float[Tensor, "m 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Relative difference of luminance, red where the render is too bright."""
    value = residual(view, rendered)[view.blocks].numpy()
    codes = np.full((*view.image.shape[:2], 3), NOTHING, np.uint8)
    rows, columns = view.places.numpy().T
    codes[rows, columns] = red_or_blue(value)
    return codes


def residual(view: FaceView, rendered: Float[Tensor, "m 3"]) -> Float[Tensor, " m"]:
    """(rendered - seen) / mean seen, of luminance.

    To be brighter than an over-exposed pixel is no difference.
    """
    seen, clipped = luminance(view.observation.pixels), view.observation.clipped
    value = (luminance(rendered) - seen) / seen.mean()
    return value if clipped is None else torch.where(clipped, value.clamp(max=0), value)


def red_or_blue(value: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    """From blue at -:data:`RESIDUAL_LIMIT` to red."""
    place = np.linspace(-RESIDUAL_LIMIT, RESIDUAL_LIMIT, len(BLUE_TO_RED))
    channels = [np.interp(value, place, colours) for colours in BLUE_TO_RED.T]
    return np.stack(channels, -1).round().astype(np.uint8)


def rgb(color: Float[Tensor, "3"]) -> str:
    return "  ".join(f"{float(value):.2f}" for value in color)


OVERLAY_SIDE_PX = 352  # as it is shown
WIDTH, MARGIN, GAP = 1920, 38.0, 21.0  # pixels of the page, at its sides, between pictures
_ABREAST = 5
_HEIGHT, _FACES_TOP, _FACES_HIGH, _LIGHT_TOP, _LIGHT_HIGH = 1224, 129.0, 396.0, 574.0, 595.0
# Advice: two lines across the page, between its title and the pictures
_CARE = TextWrapper(width=190, max_lines=2, placeholder=" ... (more in estimate.json)")


def write_report(path: Path, result: PhotoEstimate, *, title: str) -> None:
    """Write the report of one face as a PNG of 1920 x 1224 pixels."""
    draw_report(result, title).save(path)


def draw_report(result: PhotoEstimate, title: str) -> Page:
    """The photograph, the head, the face as seen and re-rendered, the light and the numbers."""
    estimate, view = result.estimate, result.view
    photo = result.photos[result.seen[0].photo]
    white = white_of(view.observation.pixels)
    page = Page(WIDTH, _HEIGHT)
    _head_line(page, result, title)
    if estimate.advice:
        care = _CARE.wrap("Take care: " + "; ".join(estimate.advice))
        for number, line in enumerate(care):
            page.write(MARGIN, 71.0 + 21 * number, line, color=ACCENT)
    wide = (WIDTH - 2 * MARGIN - (_ABREAST - 1) * GAP) / _ABREAST
    boxes = [(MARGIN + k * (wide + GAP), _FACES_TOP, wide, _FACES_HIGH) for k in range(_ABREAST)]
    rendered = estimate.faces[0].rendered
    shown = page.show(photo.encoded, "Photograph", box=boxes[0])
    _frame_head(page, shown, photo, result.face)
    page.show(_overlay(photo, result), "Head and landmarks", box=boxes[1], smooth=True)
    page.show(tone_map(view.image, white=white), "Face as seen", box=boxes[2])
    pasted = over_grey(view.image, view.places, rendered[view.blocks])
    page.show(tone_map(pasted, white=white), "Re-rendered in this light", box=boxes[3])
    shown = page.show(residual_codes(view, rendered), "Render minus seen", box=boxes[4])
    _residual_bar(page, shown)
    _light(page, result, top=_LIGHT_TOP, high=_LIGHT_HIGH, shares=(2.9, 0.93, 0.95))
    return page


def _head_line(page: Page, result: PhotoEstimate, title: str) -> None:
    page.write(MARGIN, 47.0, f"Light of {title}", size=28.3, bold=True)
    model = light_in_words(result.estimate.light)
    page.write(WIDTH - MARGIN, 43.0, model, size=TITLE, color=MUTED, anchor="rs")


def _frame_head(page: Page, shown: Panel, photo: Photo, face: DetectedFace) -> tuple[float, float]:
    """Draw a frame around a head of the photograph shown; its upper left corner on the page."""
    (left, top), (right, bottom) = (map(float, corner) for corner in head_window(photo, face))
    corners = [
        shown.at(x, y) for x, y in ((left, top), (right, top), (right, bottom), (left, bottom))
    ]
    page.line(corners, ACCENT, 2, closed=True)
    return corners[0]


def _overlay(photo: Photo, result: PhotoEstimate) -> UInt8[np.ndarray, "h w 3"]:
    """The fitted head, shaded by a lamp at the camera, over the picture, with the landmarks."""
    low, high = head_window(photo, result.face)
    crop = photo.encoded[low[1] : high[1], low[0] : high[0]]
    scale = OVERLAY_SIDE_PX / max(crop.shape[:2])
    width, height = (max(1, round(scale * side)) for side in (crop.shape[1], crop.shape[0]))
    crop = cv2.resize(
        crop, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    )
    whole = result.fit.camera
    centre = (np.array(whole.center_px) - low) * scale
    camera = Camera(
        focal_px=whole.focal_px * scale,
        width=width,
        height=height,
        center_px=(float(centre[0]), float(centre[1])),
    )
    vertices = torch.from_numpy(result.fit.vertices)
    faces = torch.from_numpy(HeadModel.load().faces.copy())
    seen = rasterize(camera, vertices, faces, Raycaster(vertices, faces))
    facing = -(seen.normals * torch.nn.functional.normalize(seen.positions, dim=1)).sum(1)
    tint = facing.clamp(0.05, 1)[:, None] * torch.tensor([120.0, 190.0, 255.0])
    picture = torch.from_numpy(crop).float()
    rows, columns = seen.pixels.unbind(1)
    picture[rows, columns] = 0.42 * picture[rows, columns] + 0.58 * tint.float()
    canvas = np.ascontiguousarray(picture.round().to(torch.uint8).numpy())
    for x, y in (result.face.points - low) * scale:
        # OpenCV counts sixteenths from pixel centres here
        at = round((x - 0.5) * 16), round((y - 0.5) * 16)
        cv2.circle(canvas, at, 40, (255, 255, 255), -1, cv2.LINE_AA, 4)
        cv2.circle(canvas, at, 28, (228, 87, 46), -1, cv2.LINE_AA, 4)
    return canvas


def _residual_bar(page: Page, shown: Panel) -> None:
    """What the colours of the residual mean, at the foot of its picture."""
    left, right = shown.left + 0.1 * shown.width, shown.left + 0.9 * shown.width
    top, thick = shown.top + 0.925 * shown.height, 10
    wide = round(right - left)
    strip = red_or_blue(np.linspace(-RESIDUAL_LIMIT, RESIDUAL_LIMIT, wide))
    x, y = round(left), round(top)
    page.canvas[y : y + thick, x : x + wide] = strip
    percent = round(100 * RESIDUAL_LIMIT)
    for share, told in ((0, f"−{percent} %"), (0.5, "0"), (1, f"+{percent} %")):
        page.write(left + share * wide, top - 7, told, size=14.2, color=MUTED, anchor="ms")


ABREAST, PHOTO_HIGH, FACE_HIGH = (
    4,
    432.0,
    216.0,
)  # of a group: pictures in a row, pixels of its rows
_TITLE_HIGH = 34.0  # pixels over a picture for its title


def write_group_report(path: Path, result: PhotoEstimate, *, title: str) -> None:
    """Write the report as a PNG 1920 pixels wide, taller the more faces there are.

    Faces have the numbers of estimate.json and of the meshes' files.
    """
    draw_group_report(result, title).save(path)


def draw_group_report(result: PhotoEstimate, title: str) -> Page:
    """All photographs, a row of pictures for each face, the light and the numbers."""
    notes = [f"Take care: {line}" for line in result.estimate.advice]
    head = 90.0 + 27 * len(notes)
    faces_top = head + PHOTO_HIGH * math.ceil(len(result.photos) / ABREAST)
    light_top = faces_top + FACE_HIGH * math.ceil(len(result.seen) / ABREAST)
    page = Page(WIDTH, round(light_top + _TITLE_HIGH + _LIGHT_HIGH) + 55)
    _head_line(page, result, title)
    for number, note in enumerate(notes, start=1):
        page.write(MARGIN, 50.0 + 27 * number, note, size=SMALL, color=ACCENT)
    _photos(page, result, head)
    _faces(page, result, faces_top)
    top = light_top + _TITLE_HIGH
    _light(page, result, top=top, high=_LIGHT_HIGH, shares=(2.9, 0.93, 1.15))
    return page


def _photos(page: Page, result: PhotoEstimate, top: float) -> None:
    """All photographs, with the numbers of the faces that were used."""
    photos = result.photos
    abreast = min(len(photos), ABREAST)
    wide = (WIDTH - 2 * MARGIN - (abreast - 1) * GAP) / abreast
    shown = [
        page.show(
            photo.encoded,
            "Photograph" if len(photos) == 1 else f"Photograph {k + 1}",
            box=(
                MARGIN + k % ABREAST * (wide + GAP),
                top + _TITLE_HIGH + k // ABREAST * PHOTO_HIGH,
                wide,
                PHOTO_HIGH - _TITLE_HIGH - GAP,
            ),
        )
        for k, photo in enumerate(photos)
    ]
    for number, seen in enumerate(result.seen, start=1):
        x, y = _frame_head(page, shown[seen.photo], photos[seen.photo], seen.face)
        page.label(x + 3, y - 11, str(number), side="left", size=15.0)


def _faces(page: Page, result: PhotoEstimate, top: float) -> None:
    """Each face as seen, as re-rendered, and what lies between."""
    white: dict[int, float] = {}  # of a photograph: its brightest face must not burn out
    for seen in result.seen:
        level = white_of(seen.view.observation.pixels)
        white[seen.photo] = max(level, white.get(seen.photo, 0.0))
    wide = (WIDTH - 2 * MARGIN - (ABREAST - 1) * 2 * GAP) / ABREAST
    each = (wide - GAP) / 3
    for k, (seen, light) in enumerate(zip(result.seen, result.estimate.faces, strict=True)):
        left = MARGIN + k % ABREAST * (wide + 2 * GAP)
        y, high = top + _TITLE_HIGH + k // ABREAST * FACE_HIGH, FACE_HIGH - _TITLE_HIGH - GAP
        boxes = [(left + i * (each + GAP / 2), y, each, high) for i in range(3)]
        scale = white[seen.photo]
        page.show(tone_map(seen.view.image, white=scale), f"{k + 1} as seen", box=boxes[0])
        pasted = over_grey(seen.view.image, seen.view.places, light.rendered[seen.view.blocks])
        page.show(tone_map(pasted, white=scale), "re-rendered", box=boxes[1])
        off = f"off by {100 * light.residual:.0f} %"
        page.show(residual_codes(seen.view, light.rendered), off, box=boxes[2])


def _light(
    page: Page, result: PhotoEstimate, *, top: float, high: float, shares: tuple[float, ...]
) -> None:
    """The light, things in it, and the numbers, in columns so wide."""
    environment, posterior = result.probe, result.estimate.posterior
    gap = 35
    unit = (WIDTH - 2 * MARGIN - (len(shares) - 1) * gap) / sum(shares)
    starts = [MARGIN + unit * sum(shares[:k]) + gap * k for k in range(len(shares))]
    shown = page.show(
        tone_map(environment.radiance),
        probe_title(posterior, result.estimate.verdict),
        box=(starts[0], top, unit * shares[0], high),
        smooth=True,
    )
    _mark_probe(page, shown, environment, result.estimate.sun_direction)
    height, width = environment.layout
    for line in region_lines(posterior, height):
        inside = line.clip(0, [width - 1, height - 1])  # it goes on behind the map's seam
        places = [shown.at(*place) for place in inside.tolist()]
        for color, thickness in (("black", 5), (REGION, 2)):
            page.line(places, color, thickness)
    each = (high - 2 * _TITLE_HIGH + 19) / 2
    diffuse, metal = relit(evaluation_scene(SCENE_HEIGHT, SCENE_GRID), environment)
    for k, (name, picture) in enumerate((("Diffuse", diffuse), ("Metal", metal))):
        box = (starts[1], top + k * (high - each), unit * shares[1], each)
        page.show(picture, f"{name} objects in this light", box=box, smooth=True)
    rows = _numbers(result)
    pitch = high * min(0.053, 1 / (len(rows) + 1))
    page.title(starts[2], top, "In numbers")
    for number, (name, value) in enumerate(rows, start=1):
        y = top + pitch * number
        page.write(starts[2], y, name, color=MUTED)
        page.write(starts[2] + unit * shares[2], y, value, anchor="rs")


def _mark_probe(
    page: Page, shown: Panel, environment: EnvironmentMap, main: Float[Tensor, "3"]
) -> None:
    """Name the axes of a full lat-long map and ring its main light."""
    height, width = environment.layout
    foot = shown.top + shown.height + 24
    for turn, word, anchor in (
        (0.0, "behind", "ls"),
        (0.25, "left", "ms"),
        (0.5, "where the camera looks", "ms"),
        (0.75, "right", "ms"),
        (1.0, "behind", "rs"),
    ):
        page.write(
            shown.left + turn * shown.width, foot, word, size=SMALL, color=MUTED, anchor=anchor
        )
    middle = round(shown.top + shown.height / 2)
    dashes = np.arange(round(shown.left), round(shown.left + shown.width)) % 12 < 6
    row = page.canvas[middle, round(shown.left) : round(shown.left) + len(dashes)]
    row[dashes] = (0.3 * row[dashes] + 0.7 * 255).astype(np.uint8)
    page.write(shown.left + 4, middle + 17.0, "horizon", size=15.0, color="white")
    row, column = (float(value) for value in pixel_from_direction(main, height, width))
    x, y = shown.at(column, row)
    # a dark ring under the bright one shows on any sky
    for color, thick in (("black", 5), (ACCENT, 3)):
        page.ring(x, y, 14.0, color, thick)
    on_right = column > 0.75 * width
    page.label(
        x - 22 if on_right else x + 22,
        y + 25 if row < height / 4 else y - 18,
        "brightest",
        side="right" if on_right else "left",
        size=16.7,
    )


# What the terms of the objective ask of an estimate: the higher, the less likely.
TERMS = {
    "data": "the face as it is lit",
    "background": "what stands behind it",
    "light_prior": "such light",
    "ground_prior": "such ground",
    "sun_prior": "a main light there",
    "albedo_prior": "skin of such colour",
    "gloss_prior": "skin as shiny",
    "pigment_prior": "skin as uneven",
    "normal_prior": "a face of such shape",
    "white_balance_prior": "such white balance",
    "edit_prior": "such an edit",
}


def _numbers(result: PhotoEstimate) -> list[tuple[str, str]]:
    estimate, fit = result.estimate, result.fit
    azimuth_deg, zenith_deg = angles_deg(estimate.sun_direction)
    rows = [
        (main_light(estimate), ""),
        (f"   {place(estimate.sun_direction)}", ""),
        ("   right of the camera's view", f"{azimuth_deg:+.0f}°"),
        ("   above the horizon", f"{90 - zenith_deg:+.0f}°"),
    ]
    ground = (
        [("ground colour (albedo)", rgb(estimate.ground_albedo))] if has_ground(estimate) else []
    )
    if len(result.seen) == 1:
        rows += [
            ("skin colour (albedo)", rgb(estimate.albedo)),
            *ground,
            ("re-rendered face off by", f"{100 * estimate.faces[0].residual:.0f} %"),
            ("pixels used", f"{len(result.view.blocks)}"),
            ("landmarks off, of eye distance", f"{100 * fit.landmark_error:.1f} %"),
            ("face turned by", f"{math.degrees(fit.facing_angle_rad):.0f}°"),
        ]
    else:
        rows += [
            *ground,
            *(
                (f"skin colour of face {number}", rgb(face.albedo))
                for number, face in enumerate(estimate.faces, start=1)
            ),
        ]
    terms = estimate.terms.items()
    return [
        *rows,
        ("found in", f"{sum(result.seconds.values()):.0f} s, {estimate.status}"),
        ("details: how unlikely (nats)", ""),
        *((f"   {TERMS.get(name, name)}", f"{value:.1f}") for name, value in terms),
    ]


# what `skylight estimate` writes of some photographs or films, and not of all
SOME_FILES = re.compile(
    r"mesh(_[1-9][0-9]*)?\.obj|probe_[0-9]{3}\.exr|(film|estimate)\.json|(film|person)\.safetensors"
)


def write_results(folder: Path, result: PhotoEstimate, *, keep_place: bool = False) -> None:
    """probe.exr, .hdr, .png, posterior.exr, mesh.obj, estimate.json, report.png of an estimate.

    Several faces have a mesh each, mesh_1.obj and so on, in the order of estimate.json. Of
    a photograph that is a file, person.safetensors is what portraits are relit by. Time,
    place and heading are private, and stand in estimate.json only with ``keep_place``.
    """
    first, *more = result.names
    title = Path(first).name + (f" and {len(more)} more" if more else "")
    write = write_report if len(result.seen) == 1 else write_group_report
    with ThreadPoolExecutor(1) as beside:  # what computes and packs lets go of Python's lock
        others = beside.submit(_write_light_and_heads, folder, result, keep_place=keep_place)
        write(folder / "report.png", result, title=title)
        others.result()


def _write_light_and_heads(folder: Path, result: PhotoEstimate, *, keep_place: bool) -> None:
    lights = json.dumps(result.lights)
    write_probe(folder, result.probe, lights=lights, exposure=result.camera_exposure)
    write_environment_map(folder / "posterior.exr", posterior_map(result.estimate.posterior))
    write_json(folder / "estimate.json", describe(result, keep_place=keep_place))
    for name, seen in zip(mesh_names(result), result.seen, strict=True):
        write_mesh(folder / name, seen.fit)
    if (face := KeptFace.of(result)).file is not None:
        write_face(folder, face)


def mesh_names(result: PhotoEstimate) -> list[str]:
    """The file of each face's head."""
    count = len(result.seen)
    return ["mesh.obj"] if count == 1 else [f"mesh_{n}.obj" for n in range(1, count + 1)]


def write_mesh(path: Path, fit: FaceFit) -> None:
    """The fitted head, metres, in the camera's frame."""
    header = "# skylight: head in metres; the camera is at the origin, looks along -Z, +Y is up\n"
    vertices, faces = fit.vertices, HeadModel.load().faces + 1
    text = (
        header
        + "v %.8f %.8f %.8f\n" * len(vertices) % tuple(vertices.ravel().tolist())
        + "f %d %d %d\n" * len(faces) % tuple(faces.ravel().tolist())
    )
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
