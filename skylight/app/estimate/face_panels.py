"""Panels of an estimate: the head framed, the face re-rendered, the residual."""

from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.app.figures.style import ACCENT
from skylight.faces.landmarks import DetectedFace
from skylight.faces.observe import FaceView
from skylight.imaging.photo import Photo
from skylight.sphere.envmap import luminance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

RESIDUAL_LIMIT = 0.5
LIGHTS = {
    "autoencoder": "light model: learnt skies (autoencoder)",
    "sunsky": "light model: sun and Preetham sky",
    "lamps": "light model: lamps in ambient light",
    "sh9": "light model: 9 spherical harmonics",
    "sh25": "light model: 25 spherical harmonics",
}


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
