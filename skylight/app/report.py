"""One picture of an estimate: what was seen, what explains it, and the light that was found."""

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.app.doubt import angles_deg, draw_region, probe_title
from skylight.app.summary import where
from skylight.faces.landmarks import DetectedFace
from skylight.faces.model import HeadModel
from skylight.faces.observe import FaceView
from skylight.imaging.atomic import atomic_path
from skylight.imaging.colour import linear_to_srgb, tone_map
from skylight.imaging.photo import Photo
from skylight.inverse.photo import PhotoEstimate
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.frame import pixel_from_direction
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import rasterize
from skylight.transport.raycast import Raycaster
from skylight.transport.scene import EvaluationScene, evaluation_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

SCENE_HEIGHT, SCENE_GRID = 144, 32  # for looking at: twice the scores' pixels, as much memory
OVERLAY_SIDE_PX = 420
RESIDUAL_LIMIT = 0.5
INK, MUTED, ACCENT = "#1d2733", "#6b7785", "#e4572e"
_MARGINS = {"left": 0.02, "right": 0.98, "top": 0.895, "bottom": 0.045}
STYLE: dict[Any, Any] = {  # matplotlib types the keys as its own literals
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "text.color": INK,
    "axes.edgecolor": "#c5ccd3",
    "axes.titlesize": 11.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
}


def write_report(path: Path, photo: Photo, result: PhotoEstimate, *, title: str) -> None:
    """Write the report as a PNG of about 1900 x 1250 pixels."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    estimate, view = result.estimate, result.view
    white = white_of(view.observation.pixels)
    with rc_context(STYLE):
        figure = Figure(figsize=(16, 10.2), dpi=120, facecolor="white")
        figure.text(0.02, 0.962, f"Light of {title}", fontsize=17, fontweight="bold")
        figure.text(0.98, 0.965, LIGHTS[estimate.light], ha="right", color=MUTED, fontsize=11.5)
        if estimate.advice:
            care = "Take care: " + "; ".join(estimate.advice)
            figure.text(0.02, 0.936, care, color=ACCENT, fontsize=10.5)
        rows = figure.add_gridspec(2, 1, height_ratios=(1, 1.5), **_MARGINS, hspace=0.1)
        seen = rows[0].subgridspec(1, 5, wspace=0.06)
        axes = [figure.add_subplot(cell) for cell in seen]
        _photo(axes[0], photo, result)
        show(axes[1], _overlay(photo, result), "Head and landmarks")
        image = view.image
        rendered = estimate.faces[0].rendered
        show(axes[2], codes(image, white), "Face as seen")
        show(axes[3], codes(over_grey(view, rendered), white), "Re-rendered in the light found")
        shown = show_residual(axes[4], view, rendered, "Render minus seen")
        _residual_bar(figure, axes[4], shown)
        found = rows[1].subgridspec(2, 3, width_ratios=(2.9, 0.93, 0.95), wspace=0.06, hspace=0.18)
        probe = figure.add_subplot(found[:, 0])
        show_probe(probe, estimate.environment, probe_title(estimate.posterior))
        draw_region(probe, estimate.posterior)
        scene = evaluation_scene(SCENE_HEIGHT, SCENE_GRID)
        matt, metal = relit(scene, estimate.environment)
        show(figure.add_subplot(found[0, 1]), matt, "Matt objects in this light")
        show(figure.add_subplot(found[1, 1]), metal, "Metal objects in this light")
        numbers = figure.add_subplot(found[:, 2])
        write_numbers(numbers, "In numbers", _numbers(result))
        save(figure, path)


LIGHTS = {
    "autoencoder": "light model: learnt skies (autoencoder)",
    "sunsky": "light model: sun and Preetham sky",
    "sh9": "light model: 9 spherical harmonics",
    "sh25": "light model: 25 spherical harmonics",
}


def save(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    drawn = io.BytesIO()  # so that only the disk can fail while the file is open
    figure.savefig(drawn, format="png")
    with atomic_path(path) as temporary:
        temporary.write_bytes(drawn.getvalue())


def show(axes: "Axes", picture: UInt8[np.ndarray, "h w 3"], title: str) -> None:
    """A picture without ticks under its title."""
    axes.imshow(picture, interpolation="nearest")
    axes.set_title(title)
    axes.set_anchor("NW")
    axes.set_xticks([])
    axes.set_yticks([])


def show_probe(
    axes: "Axes", environment: EnvironmentMap, title: str, *, white: float | None = None
) -> None:
    """A full lat-long map with its axes named and its brightest direction ringed."""
    height, width = environment.layout
    show(axes, tone_map(environment.radiance, white=white), title)
    axes.set_xticks(
        [(turn + 0.5) * width - 0.5 for turn in (-0.5, -0.25, 0, 0.25, 0.5)],
        ["behind", "left", "where the camera looks", "right", "behind"],
    )
    labels = axes.get_xticklabels()
    labels[0].set_horizontalalignment("left")
    labels[-1].set_horizontalalignment("right")
    axes.axhline(height / 2 - 0.5, color="white", linewidth=0.9, alpha=0.7, linestyle=(0, (4, 4)))
    axes.text(0.5, height / 2, "horizon", color="white", fontsize=9, va="top", alpha=0.9)
    sun = environment.brightest_direction()
    row, column = (float(value) for value in pixel_from_direction(sun, height, width))
    # a dark ring under the bright one shows on any sky
    for color, line in (("black", 4.0), (ACCENT, 2.2)):
        axes.plot(
            column,
            row,
            marker="o",
            markersize=17,
            markerfacecolor="none",
            markeredgecolor=color,
            markeredgewidth=line,
            clip_on=False,
        )
    on_right = column > 0.75 * width
    axes.annotate(
        "brightest",
        (column, row),
        xytext=(-13 if on_right else 13, -15 if row < height / 4 else 11),
        textcoords="offset points",
        ha="right" if on_right else "left",
        va="center",
        color="white",
        fontsize=10,
        fontweight="bold",
        bbox={"boxstyle": "round,pad=0.25", "facecolor": ACCENT, "edgecolor": "none"},
    )


def write_numbers(
    axes: "Axes", title: str, rows: list[tuple[str, str]], *, pitch: float = 0.053
) -> None:
    """A table of names and values, ``pitch`` of the axes' height apart."""
    axes.set_axis_off()
    axes.set_title(title)
    for place, (name, value) in enumerate(rows):
        y = 1 - pitch * (place + 0.95)
        axes.text(0, y, name, color=MUTED, transform=axes.transAxes)
        axes.text(1, y, value, transform=axes.transAxes, ha="right")


def relit(
    scene: EvaluationScene, environment: EnvironmentMap, *, like: EnvironmentMap | None = None
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """(matt objects, metal objects) in this light, exposed for them or as in the light ``like``."""
    like = like or environment
    matt_white = white_of(scene.shade(like))
    metal_white = white_of(scene.relight_glossy(like).reshape(-1, 3))
    return (
        tone_map(scene.relight(environment), white=matt_white),
        tone_map(scene.relight_glossy(environment), white=metal_white),
    )


def white_of(values: Float[Tensor, "m 3"]) -> float:
    """The luminance to show as white: a little above nearly all."""
    return max(1.05 * float(torch.quantile(luminance(values.float()), 0.98)), 1e-30)


def codes(linear: Float[Tensor, "h w 3"], white: float) -> UInt8[np.ndarray, "h w 3"]:
    return (255 * linear_to_srgb((linear / white).clamp(0, 1))).round().to(torch.uint8).numpy()


def _photo(axes: "Axes", photo: Photo, result: PhotoEstimate) -> None:
    """The whole picture with the face framed."""
    show(axes, photo.encoded, "Photograph")
    frame_head(axes, photo, result.face)


def frame_head(axes: "Axes", photo: Photo, face: DetectedFace) -> tuple[float, float]:
    """Draw a frame around a head of the picture shown; its upper left corner."""
    from matplotlib.patches import Rectangle

    low, high = _head_window(photo, face)
    axes.add_patch(
        Rectangle(tuple(low), *(high - low), fill=False, edgecolor=ACCENT, linewidth=1.8)
    )
    return float(low[0]), float(low[1])


def _head_window(photo: Photo, face: DetectedFace) -> tuple[np.ndarray, np.ndarray]:
    """(left, top) and (right, bottom) in pixels around the head's front, within the picture."""
    points = face.points
    margin = 0.5 * np.ptp(points, axis=0).max()
    height, width = photo.encoded.shape[:2]
    low = np.clip(points.min(0) - margin * np.array([1.0, 1.2]), 0, None)
    high = np.minimum(points.max(0) + margin * np.array([1.0, 0.6]), [width, height])
    return np.floor(low).astype(int), np.ceil(high).astype(int)


def _overlay(photo: Photo, result: PhotoEstimate) -> UInt8[np.ndarray, "h w 3"]:
    """The fitted head, shaded by a lamp at the camera, over the picture, with the landmarks."""
    low, high = _head_window(photo, result.face)
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


def over_grey(view: FaceView, rendered: Float[Tensor, "m 3"]) -> Float[Tensor, "h w 3"]:
    """The re-rendered face over its picture, dimmed and grey."""
    picture = (0.35 * luminance(view.image))[..., None].repeat(1, 1, 3)
    rows, columns = view.observation.places.unbind(1)
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
    rows, columns = view.observation.places.unbind(1)
    canvas[rows.numpy(), columns.numpy()] = value.numpy()
    shown = axes.imshow(canvas, cmap="RdBu_r", vmin=-RESIDUAL_LIMIT, vmax=RESIDUAL_LIMIT)
    axes.set_facecolor("#eceff2")
    axes.set_title(title)
    axes.set_anchor("NW")
    axes.set_xticks([])
    axes.set_yticks([])
    return shown


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
        ("pixels used", f"{len(result.view.observation.pixels)}"),
        ("landmarks off, of eye distance", f"{100 * fit.landmark_error:.1f} %"),
        ("face turned by", f"{math.degrees(fit.facing_angle_rad):.0f}°"),
        ("optimisation", estimate.status),
        *((f"   {name.replace('_', ' ')}, nats", f"{value:.1f}") for name, value in terms),
        ("seconds", f"{sum(result.seconds.values()):.1f}"),
    ]


def rgb(color: Float[Tensor, "3"]) -> str:
    return "  ".join(f"{float(value):.2f}" for value in color)
