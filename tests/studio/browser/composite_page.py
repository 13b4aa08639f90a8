"""What tests do with the object in the photo, and read of it."""

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from skylight.imaging._colour import srgb_to_linear
from skylight.sphere._frame import DirectionGrid
from tests.studio.browser.known_light import FOCAL, SIZE

if TYPE_CHECKING:
    from playwright.sync_api import Page


def placement(page: "Page") -> dict[str, Any]:
    """Where the page says the object is: foot and size in metres."""
    return json.loads(page.locator(".composite").get_attribute("data-placement") or "")


def pixel(point: Any) -> tuple[int, int]:
    """Row and column at which a point is seen."""
    x, y, z = point
    return round(SIZE / 2 + FOCAL * y / z - 0.5), round(SIZE / 2 - FOCAL * x / z - 0.5)


def moved(point: Any, *by: float) -> np.ndarray:
    return np.array(point) + np.array(by)


def choose(page: "Page", label: str, value: str) -> None:
    page.get_by_label(label, exact=True).select_option(value)


def sunlight(azimuth_deg: float, zenith_deg: float, sky: float = 0.0) -> torch.Tensor:
    """Two pixels of sun that give a surface facing them an irradiance of 3."""
    radiance = torch.full((64, 128, 3), sky)
    row, column = int(zenith_deg / 180 * 64), int((azimuth_deg / 360 + 0.5) * 128) % 128
    pair = [column, (column + 1) % 128]
    solid_angle = DirectionGrid.latlong(64).solid_angles.reshape(64, 128)[row, pair].sum()
    radiance[row, pair] += float(3 / solid_angle)
    return radiance


def linear(seen: np.ndarray) -> np.ndarray:
    return srgb_to_linear(torch.as_tensor(seen / 255)).numpy()


def click_corners(page: "Page", points: np.ndarray) -> None:
    layer = page.locator(".corners")
    layer.wait_for()
    layer.scroll_into_view_if_needed()
    box = layer.bounding_box()
    assert box is not None
    for x, y, z in points:
        column, row = SIZE / 2 - FOCAL * x / z, SIZE / 2 + FOCAL * y / z
        page.mouse.click(
            box["x"] + column / SIZE * box["width"], box["y"] + row / SIZE * box["height"]
        )
