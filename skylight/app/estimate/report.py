"""The report figure of an estimate: photograph, re-rendering, residual, light, numbers."""

import math
from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch
from jaxtyping import UInt8

from skylight.app.estimate.face_panels import (
    LIGHTS,
    RESIDUAL_LIMIT,
    frame_head,
    head_window,
    over_grey,
    rgb,
    show_residual,
)
from skylight.app.estimate.summary import where
from skylight.app.estimate.types import PhotoEstimate
from skylight.app.estimate.uncertainty import draw_region, probe_title
from skylight.app.figures.angles import angles_deg
from skylight.app.figures.exposure import white_of
from skylight.app.figures.panels import show, show_probe, write_numbers
from skylight.app.figures.relit import SCENE_GRID, SCENE_HEIGHT, relit
from skylight.app.figures.style import ACCENT, MUTED, STYLE, save
from skylight.faces.model import HeadModel
from skylight.imaging.colour import tone_map
from skylight.imaging.photo import Photo
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import rasterize
from skylight.transport.raycast import Raycaster
from skylight.transport.scene.evaluation import evaluation_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

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
        figure.text(0.98, 0.965, LIGHTS[estimate.light], ha="right", color=MUTED, fontsize=11.5)
        if estimate.advice:
            care = _CARE.fill("Take care: " + "; ".join(estimate.advice))
            figure.text(0.02, 0.952, care, color=ACCENT, fontsize=10.5, va="top", linespacing=1.1)
        rows = figure.add_gridspec(2, 1, height_ratios=(1, 1.5), **_MARGINS, hspace=0.1)
        seen = rows[0].subgridspec(1, 5, wspace=0.06)
        axes = [figure.add_subplot(cell) for cell in seen]
        _photo(axes[0], photo, result)
        show(axes[1], _overlay(photo, result), "Head and landmarks")
        image = view.image
        rendered = estimate.faces[0].rendered
        show(axes[2], tone_map(image, white=white), "Face as seen")
        pasted = over_grey(view.image, view.places, rendered[view.blocks])
        show(axes[3], tone_map(pasted, white=white), "Re-rendered in this light")
        shown = show_residual(axes[4], view, rendered, "Render minus seen")
        _residual_bar(figure, axes[4], shown)
        found = rows[1].subgridspec(2, 3, width_ratios=(2.9, 0.93, 0.95), wspace=0.06, hspace=0.18)
        probe = figure.add_subplot(found[:, 0])
        show_probe(probe, estimate.environment, probe_title(estimate.posterior))
        draw_region(probe, estimate.posterior, estimate.environment.layout[0])
        scene = evaluation_scene(SCENE_HEIGHT, SCENE_GRID)
        matt, metal = relit(scene, estimate.environment)
        show(figure.add_subplot(found[0, 1]), matt, "Matt objects in this light")
        show(figure.add_subplot(found[1, 1]), metal, "Metal objects in this light")
        numbers = figure.add_subplot(found[:, 2])
        write_numbers(numbers, "In numbers", _numbers(result))
        save(figure, path)


def _photo(axes: "Axes", photo: Photo, result: PhotoEstimate) -> None:
    """The whole picture with the face framed."""
    show(axes, photo.encoded, "Photograph")
    frame_head(axes, photo, result.face)


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


def _numbers(result: PhotoEstimate) -> list[tuple[str, str]]:
    estimate, fit = result.estimate, result.fit
    azimuth_deg, zenith_deg = angles_deg(estimate.sun_direction)
    terms = estimate.terms.items()
    return [
        ("brightest", where(azimuth_deg, zenith_deg)),
        ("   azimuth, right of ahead", f"{azimuth_deg:+.0f}°"),
        ("   zenith angle", f"{zenith_deg:.0f}°"),
        ("skin albedo", rgb(estimate.albedo)),
        ("ground albedo", rgb(estimate.ground_albedo)),
        ("mean residual", f"{100 * estimate.faces[0].residual:.0f} %"),
        ("pixels used", f"{len(result.view.blocks)}"),
        ("landmarks off, of eye distance", f"{100 * fit.landmark_error:.1f} %"),
        ("face turned by", f"{math.degrees(fit.facing_angle_rad):.0f}°"),
        ("optimisation", estimate.status),
        *((f"   {name.replace('_', ' ')}, nats", f"{value:.1f}") for name, value in terms),
        ("seconds", f"{sum(result.seconds.values()):.1f}"),
    ]
