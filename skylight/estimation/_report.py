"""The files of an estimate: maps, meshes, numbers, and the report that shows it all.

The report of one face has the photograph, the head framed, the face re-rendered, the residual, the
light and the numbers; that of several faces a row for each.
"""

import json
import math
import re
from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING

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
    STYLE,
    angles_deg,
    relit,
    save,
    show,
    show_probe,
    white_of,
    write_numbers,
)
from skylight.estimation._kept import KeptFace, write_face
from skylight.estimation._summary import (
    PhotoEstimate,
    describe,
    describe_lights,
    draw_region,
    has_ground,
    main_light,
    posterior_map,
    probe_title,
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
from skylight.sphere._envmap import luminance
from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize
from skylight.transport._scene import evaluation_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.gridspec import GridSpecBase
    from matplotlib.image import AxesImage


RESIDUAL_LIMIT = 0.5
LIGHTS = {
    "sphere": "light model: any place, all round (sphere)",
    "autoencoder": "light model: learnt skies (autoencoder)",
    "sunsky": "light model: sun and Preetham sky",
    "lamps": "light model: lamps in ambient light",
    "sh9": "light model: 9 spherical harmonics",
    "sh25": "light model: 25 spherical harmonics",
}


def light_in_words(name: str) -> str:
    """A light model as reports name it: the user's own by its name, in which $ is no formula."""
    return LIGHTS.get(name, f"light model: {name}".replace("$", r"\$"))


def frame_head(axes: "Axes", photo: Photo, face: DetectedFace) -> tuple[float, float]:
    """Draw a frame around a head of the picture shown; its upper left corner."""
    from matplotlib.patches import Rectangle

    low, high = head_window(photo, face)
    axes.add_patch(
        Rectangle(tuple(low), *(high - low), fill=False, edgecolor=ACCENT, linewidth=1.8)
    )
    return float(low[0]), float(low[1])


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


def show_residual(
    axes: "Axes", view: FaceView, rendered: Float[Tensor, "m 3"], title: str
) -> "AxesImage":
    """Relative difference of luminance, red where the render is too bright.

    To be brighter than an over-exposed pixel is no difference.
    """
    seen, clipped = luminance(view.observation.pixels), view.observation.clipped
    value = (luminance(rendered) - seen) / seen.mean()
    if clipped is not None:
        value = torch.where(clipped, value.clamp(max=0), value)
    canvas = np.full(tuple(view.image.shape[:2]), np.nan)
    rows, columns = view.places.unbind(1)
    canvas[rows.numpy(), columns.numpy()] = value[view.blocks].numpy()
    shown = axes.imshow(canvas, cmap="RdBu_r", vmin=-RESIDUAL_LIMIT, vmax=RESIDUAL_LIMIT)
    axes.set_facecolor("#eceff2")
    axes.set_title(title)
    axes.set_anchor("NW")
    axes.set_xticks([])
    axes.set_yticks([])
    return shown


def rgb(color: Float[Tensor, "3"]) -> str:
    return "  ".join(f"{float(value):.2f}" for value in color)


OVERLAY_SIDE_PX = 420
# Advice: two lines across the page, between its title and the pictures
_CARE = TextWrapper(width=190, max_lines=2, placeholder=" ... (more in estimate.json)")
_MARGINS = {"left": 0.02, "right": 0.98, "top": 0.895, "bottom": 0.045}


def write_report(path: Path, result: PhotoEstimate, *, title: str) -> None:
    """Write the report as a PNG of about 1900 x 1250 pixels."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    estimate, view = result.estimate, result.view
    photo = result.photos[result.seen[0].photo]
    white = white_of(view.observation.pixels)
    with rc_context(STYLE):
        figure = Figure(figsize=(16, 10.2), dpi=120, facecolor="white")
        figure.text(0.02, 0.962, f"Light of {title}", fontsize=17, fontweight="bold")
        figure.text(
            0.98, 0.965, light_in_words(estimate.light), ha="right", color=MUTED, fontsize=11.5
        )
        if estimate.advice:
            care = _CARE.fill("Take care: " + "; ".join(estimate.advice))
            figure.text(0.02, 0.952, care, color=ACCENT, fontsize=10.5, va="top", linespacing=1.1)
        rows = figure.add_gridspec(2, 1, height_ratios=(1, 1.5), **_MARGINS, hspace=0.1)
        seen = rows[0].subgridspec(1, 5, wspace=0.06)
        axes = [figure.add_subplot(cell) for cell in seen]
        show(axes[0], photo.encoded, "Photograph")
        frame_head(axes[0], photo, result.face)
        show(axes[1], _overlay(photo, result), "Head and landmarks")
        image = view.image
        rendered = estimate.faces[0].rendered
        show(axes[2], tone_map(image, white=white), "Face as seen")
        pasted = over_grey(view.image, view.places, rendered[view.blocks])
        show(axes[3], tone_map(pasted, white=white), "Re-rendered in this light")
        shown = show_residual(axes[4], view, rendered, "Render minus seen")
        _residual_bar(figure, axes[4], shown)
        _light(
            figure,
            rows[1].subgridspec(2, 3, width_ratios=(2.9, 0.93, 0.95), wspace=0.06, hspace=0.18),
            result,
        )
        save(figure, path)


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


def _residual_bar(figure: "Figure", axes: "Axes", shown: "AxesImage") -> None:
    inset = axes.inset_axes((0.1, 0.045, 0.8, 0.028))
    bar = figure.colorbar(shown, cax=inset, orientation="horizontal")
    percent = round(100 * RESIDUAL_LIMIT)
    bar.set_ticks(
        [-RESIDUAL_LIMIT, 0, RESIDUAL_LIMIT], labels=[f"−{percent} %", "0", f"+{percent} %"]
    )
    inset.xaxis.set_ticks_position("top")
    inset.tick_params(labelsize=8.5, length=2, pad=1)


ABREAST = 4
WIDTH, PHOTO_ROW, FACE_ROW, LIGHT_ROW = 16.0, 3.6, 1.8, 6.0  # inches


def write_group_report(path: Path, result: PhotoEstimate, *, title: str) -> None:
    """Write the report as a PNG 1920 pixels wide, taller the more faces there are.

    Faces have the numbers of estimate.json and of the meshes' files.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    rows = (
        PHOTO_ROW * math.ceil(len(result.photos) / ABREAST),
        FACE_ROW * math.ceil(len(result.seen) / ABREAST),
        LIGHT_ROW,
    )
    notes = [f"Take care: {line}" for line in result.estimate.advice]
    head = 0.75 + 0.22 * len(notes)
    height = head + sum(rows)
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), dpi=120, facecolor="white")
        top = 1 - 0.42 / height
        figure.text(0.02, top, f"Light of {title}", fontsize=17, fontweight="bold")
        light = light_in_words(result.estimate.light)
        figure.text(0.98, top, light, ha="right", color=MUTED, fontsize=11.5)
        for number, note in enumerate(notes, start=1):
            at = top - 0.24 * number / height
            figure.text(0.02, at, note, color=ACCENT, fontsize=9.5)
        parts = figure.add_gridspec(4, 1, height_ratios=(head, *rows), hspace=0, top=1, bottom=0)
        _photos(figure.add_subfigure(parts[1]), result)
        _faces(figure.add_subfigure(parts[2]), result)
        area = figure.add_subfigure(parts[3])
        cells = area.add_gridspec(
            2,
            3,
            width_ratios=(2.9, 0.93, 1.15),
            left=0.02,
            right=0.98,
            top=0.93,
            bottom=0.06,
            wspace=0.06,
            hspace=0.18,
        )
        _light(area, cells, result)
        save(figure, path)


def _photos(area: "SubFigure", result: PhotoEstimate) -> None:
    """All photographs, with the numbers of the faces that were used."""
    photos = result.photos
    for number, (photo, axes) in enumerate(
        zip(photos, _cells(area, len(photos)), strict=True), start=1
    ):
        show(axes, photo.encoded, "Photograph" if len(photos) == 1 else f"Photograph {number}")
    for number, seen in enumerate(result.seen, start=1):
        axes, photo = area.axes[seen.photo], photos[seen.photo]
        left, top = frame_head(axes, photo, seen.face)
        axes.text(
            left,
            top,
            str(number),
            color="white",
            fontsize=9,
            fontweight="bold",
            va="bottom",
            bbox={"boxstyle": "square,pad=0.2", "facecolor": ACCENT, "edgecolor": "none"},
        )


def _cells(area: "SubFigure", count: int) -> "list[Axes]":
    rows = math.ceil(count / ABREAST)
    grid = area.add_gridspec(
        rows,
        min(count, ABREAST),
        left=0.02,
        right=0.98,
        top=1 - 0.1 / rows,
        bottom=0.03,
        wspace=0.08,
        hspace=0.16,
    )
    return [area.add_subplot(grid[k // ABREAST, k % ABREAST]) for k in range(count)]


def _faces(area: "SubFigure", result: PhotoEstimate) -> None:
    """Each face as seen, as re-rendered, and what lies between."""
    white: dict[int, float] = {}  # of a photograph: its brightest face must not burn out
    for seen in result.seen:
        level = white_of(seen.view.observation.pixels)
        white[seen.photo] = max(level, white.get(seen.photo, 0.0))
    rows = math.ceil(len(result.seen) / ABREAST)
    grid = area.add_gridspec(
        rows, ABREAST, left=0.02, right=0.98, top=1 - 0.16 / rows, bottom=0.02, wspace=0.06
    )
    for k, (seen, light) in enumerate(zip(result.seen, result.estimate.faces, strict=True)):
        cell = grid[k // ABREAST, k % ABREAST].subgridspec(1, 3, wspace=0.06)
        axes = [area.add_subplot(part) for part in cell]
        scale = white[seen.photo]
        show(axes[0], tone_map(seen.view.image, white=scale), f"{k + 1} as seen")
        pasted = over_grey(seen.view.image, seen.view.places, light.rendered[seen.view.blocks])
        show(axes[1], tone_map(pasted, white=scale), "re-rendered")
        off = f"off by {100 * light.residual:.0f} %"
        show_residual(axes[2], seen.view, light.rendered, off)


def _light(area: "Figure | SubFigure", cells: "GridSpecBase", result: PhotoEstimate) -> None:
    """The light, things in it, and the numbers, in two rows of three cells."""
    environment, posterior = result.probe, result.estimate.posterior
    probe = area.add_subplot(cells[:, 0])
    title = probe_title(posterior, result.estimate.verdict)
    show_probe(probe, environment, title, main=result.estimate.sun_direction)
    draw_region(probe, posterior, environment.layout[0])
    diffuse, metal = relit(evaluation_scene(SCENE_HEIGHT, SCENE_GRID), environment)
    show(area.add_subplot(cells[0, 1]), diffuse, "Diffuse objects in this light")
    show(area.add_subplot(cells[1, 1]), metal, "Metal objects in this light")
    rows = _numbers(result)
    pitch = min(0.053, 1 / (len(rows) + 1))
    write_numbers(area.add_subplot(cells[:, 2]), "In numbers", rows, pitch=pitch)


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
    r"mesh(_[1-9][0-9]*)?\.obj|probe_[0-9]{3}\.exr|(film|estimate)\.json|person\.safetensors"
)


def write_results(folder: Path, result: PhotoEstimate, *, keep_place: bool = False) -> None:
    """probe.exr, .hdr, .png, posterior.exr, mesh.obj, estimate.json, report.png of an estimate.

    Several faces have a mesh each, mesh_1.obj and so on, in the order of estimate.json. Of
    a photograph that is a file, person.safetensors is what portraits are relit by. Time,
    place and heading are private, and stand in estimate.json only with ``keep_place``.
    """
    lights = json.dumps(describe_lights(result.estimate))
    write_probe(folder, result.probe, lights=lights, exposure=result.camera_exposure)
    write_environment_map(folder / "posterior.exr", posterior_map(result.estimate.posterior))
    write_json(folder / "estimate.json", describe(result, keep_place=keep_place))
    for name, seen in zip(mesh_names(result), result.seen, strict=True):
        write_mesh(folder / name, seen.fit)
    if (face := KeptFace.of(result)).file is not None:
        write_face(folder, face)
    first, *more = result.names
    title = Path(first).name + (f" and {len(more)} more" if more else "")
    if len(result.seen) == 1:
        write_report(folder / "report.png", result, title=title)
    else:
        write_group_report(folder / "report.png", result, title=title)


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
