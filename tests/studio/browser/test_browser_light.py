"""What the page shows of light that is known: the right colours on the right side, at their level.

The page is the real one in a real browser. Only the estimate is replaced: its job ends at once with
a map of light that the test made.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from PIL import Image
from skimage.data import astronaut

from skylight.imaging._colour import srgb_to_linear
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from tests.studio.browser.known_light import REGION
from tests.studio.browser.pictures import codes, pixels
from tests.studio.browser.waiting import expect

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page


def exposure(page: "Page") -> float:
    """The factor that the slider stands at."""
    return 2.0 ** float(page.get_by_label("Exposure of the views").input_value())


def directions_as_colours() -> torch.Tensor:
    """Radiance (d + 1) / 2 from direction d: +X red, +Y green, +Z blue."""
    return ((DirectionGrid.latlong(64).directions + 1) / 2).reshape(64, 128, 3).float()


def test_each_axis_is_on_its_side(show: Callable[..., "Page"]) -> None:
    page = show(directions_as_colours())
    scale = exposure(page)
    panorama = pixels(page, ".panorama canvas")
    height, width = panorama.shape[:2]
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        towards = torch.as_tensor(direction + 0.02)  # off the seam and the poles
        row, column = pixel_from_direction(towards / towards.norm(), height, width)
        seen = panorama[round(float(row)), round(float(column)), :3]
        want = codes(scale * (np.asarray(towards / towards.norm()) + 1) / 2)
        assert np.abs(seen - want).max() < 8, direction

    ball = pixels(page, ".balls canvas")
    middle, radius = len(ball) / 2, len(ball) / 2 - 1
    half = math.sqrt(0.5)  # where a mirror ball shows what lies at right angles to the view
    for (x, y), seen_there in {
        (0.0, 0.0): (0, 0, 1),  # itself shows what lies behind the camera
        (half, 0.0): (1, 0, 0),
        (-half, 0.0): (-1, 0, 0),
        (0.0, half): (0, 1, 0),
        (0.0, -half): (0, -1, 0),
    }.items():
        seen = ball[int(middle - y * radius), int(middle + x * radius), :3]
        want = codes(scale * (np.array(seen_there) + 1) / 2)
        assert np.abs(seen - want).max() < 10, (x, y)


def test_a_line_runs_about_where_the_sun_may_stand(show: Callable[..., "Page"]) -> None:
    panorama = pixels(show(torch.full((64, 128, 3), 0.01)), ".panorama canvas")[..., :3]
    cell = len(panorama) / 64
    yellow = (np.abs(panorama - (255, 210, 63)).max(-1) < 30).nonzero()
    for places, region in zip(yellow, REGION, strict=True):
        # from centre to centre of the outermost cells, and half the line's width
        assert places.min() == pytest.approx(cell * (region.start + 0.5), abs=cell)
        assert places.max() == pytest.approx(cell * (region.stop - 0.5), abs=cell)


def test_the_matte_ball_shows_the_irradiance_over_pi(show: Callable[..., "Page"]) -> None:
    """Under a cap about the zenith and a patch to the right, which are no even number of rows."""
    radiance = torch.zeros(64, 128, 3)
    radiance[0] = torch.tensor([60.0, 30.0, 0.0])
    radiance[35:38, 95:98] = torch.tensor([0.0, 8.0, 16.0])
    page = show(radiance)
    ball = pixels(page, ".balls figure:nth-child(3) canvas")
    middle, radius = len(ball) / 2, len(ball) / 2 - 1
    grid = DirectionGrid.latlong(64)
    for x, y in [(0.0, 0.0), (0.0, 0.7), (0.6, 0.3), (-0.5, 0.5), (0.8, -0.2), (0.3, 0.8)]:
        column, row = int(middle + x * radius), int(middle - y * radius)
        right, up = (column + 0.5 - middle) / radius, (middle - row - 0.5) / radius
        towards = torch.tensor([right, up, math.sqrt(1 - right**2 - up**2)], dtype=torch.float64)
        cosines = (grid.directions.double() @ towards).clamp(min=0) * grid.solid_angles.double()
        irradiance = cosines @ radiance.reshape(-1, 3).double()
        want = exposure(page) * irradiance / math.pi
        assert want.max() < 1
        seen = srgb_to_linear(torch.as_tensor(ball[row, column, :3] / 255))
        assert (seen - want).abs().max() < 0.015, (x, y)


def test_other_pages_offer_a_found_light_until_its_photo_goes(
    show: Callable[..., "Page"], tmp_path: Path
) -> None:
    page = show(torch.full((64, 128, 3), 0.6))
    found = page.get_by_label("Light", exact=True).locator("option", has_text="Found: photo.png")

    def offers(count: int) -> None:
        page.evaluate("location.hash = '#/codes'")
        page.get_by_role("heading", level=1, name="Light in few pieces").wait_for()
        expect(found).to_have_count(count)
        page.evaluate("location.hash = '#/face'")
        page.get_by_role("heading", level=1, name="Light from a face").wait_for()

    offers(1)
    Image.fromarray(astronaut()[:, ::-1]).save(tmp_path / "other.png")
    page.set_input_files("input[type=file][accept^='image']", tmp_path / "other.png")
    page.get_by_alt_text("other.png").wait_for()
    offers(0)


def test_a_light_that_cannot_be_fetched_says_so(show: Callable[..., "Page"]) -> None:
    page = show(torch.full((64, 128, 3), 0.6))
    page.route("**/probe.exr", lambda route: route.abort())
    page.get_by_role("tab", name="Photo").click()
    again = page.get_by_role("button", name="Find this light too")
    again.click()
    page.get_by_role("alert").get_by_text("The studio does not answer").wait_for()
    expect(again).to_be_enabled()
    expect(page.get_by_label("Light shown").locator("option")).to_have_count(1)
