"""What the page shows of light that is known: the right colours on the right side, at their level.

The page is the real one in a real browser. Only the estimate is replaced: its job ends at once with
a map of light that the test made.
"""

import base64
import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from PIL import Image
from skimage.data import astronaut

from skylight.imaging.colour import linear_to_srgb, srgb_to_linear
from skylight.sphere.frame import pixel_from_direction
from skylight.sphere.grid import DirectionGrid
from tests.studio.browser.known_light import REGION, SIZE
from tests.studio.browser.waiting import expect, gathered

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page

FOOT = (0.75 * SIZE, 0.9 * SIZE)  # of the object when it is first placed, pixels
HEIGHT = 0.2 * SIZE  # of the object, pixels


def pixels(page: "Page", selector: str) -> np.ndarray:
    """A canvas' or a picture's pixels, (h, w, 4)."""
    url = page.evaluate(
        """async selector => {
            const shown = document.querySelector(selector);
            const copy = document.createElement("canvas");
            copy.width = shown.naturalWidth ?? shown.width;
            copy.height = shown.naturalHeight ?? shown.height;
            copy.getContext("2d").drawImage(shown, 0, 0);
            return copy.toDataURL();
        }""",
        selector,
    )
    content = base64.b64decode(url.partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGBA")).astype(int)


def photo_pixels(page: "Page") -> np.ndarray:
    """The preview as the browser decodes it, (h, w, 3)."""
    return pixels(page, ".photo img")[..., :3]


def exposure(page: "Page") -> float:
    """The factor that the slider stands at."""
    return 2.0 ** float(page.get_by_label("Exposure of the views").input_value())


def codes(linear: Any) -> np.ndarray:
    """8-bit codes of linear light."""
    value = torch.as_tensor(np.asarray(linear, dtype=np.float64))
    return (255 * linear_to_srgb(value.clamp(0, 1))).numpy()


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

    page.get_by_label("Object", exact=True).select_option("ball")
    page.get_by_label("Surface", exact=True).select_option("mirror")
    in_photo = finished(page, 1 / 64)
    column, row = round(FOOT[0]), round(FOOT[1] - HEIGHT / 2)
    side = round(0.3 * HEIGHT)
    left, right = in_photo[row, column - side, :3], in_photo[row, column + side, :3]
    above, below = in_photo[row - side, column, :3], in_photo[row + side, column, :3]
    assert right[0] > left[0] + 60
    assert above[1] > below[1] + 60
    assert in_photo[row, column, 2] > 200


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


def finished(page: "Page", share: float) -> np.ndarray:
    """The picture with the object, once at least this share of its light is in."""
    gathered(page, share)
    return pixels(page, "canvas.composite")


def test_an_object_in_even_light_has_its_albedo_and_the_photo_stays(
    show: Callable[..., "Page"],
) -> None:
    page = show(torch.full((64, 128, 3), 0.6))
    page.get_by_label("Object", exact=True).select_option("ball")
    page.get_by_label("Surface", exact=True).select_option("matte")
    picture = finished(page, 1 / 4)[..., :3]
    column, row = round(FOOT[0]), round(FOOT[1] - HEIGHT / 2)
    ball = picture[row - 25 : row + 25, column - 25 : column + 25]
    want = codes(0.8 * 0.6)
    assert np.abs(ball.mean((0, 1)) - want).max() < 3
    assert np.abs(ball - want).max() < 10
    photo = photo_pixels(page)
    far = np.s_[: SIZE // 2]  # above the horizon nothing is shaded
    assert np.abs(picture[far] - photo[far]).max() <= 1
    under = round(FOOT[1]) + 2, column
    assert picture[under].max() < 0.8 * photo[under].min()


def test_the_sun_on_the_right_throws_a_shadow_to_the_left(show: Callable[..., "Page"]) -> None:
    radiance = torch.zeros(64, 128, 3)
    radiance[15, 95:97] = 400.0  # azimuth 90, zenith 44 degrees
    page = show(radiance)
    page.get_by_label("Object", exact=True).select_option("box")
    picture, photo = finished(page, 1 / 64)[..., :3], photo_pixels(page)
    row, column = round(FOOT[1]), round(FOOT[0])
    left, right = round(column - 1.0 * HEIGHT), round(column + 1.0 * HEIGHT)
    assert picture[row, left].max() <= 2  # all light came from the sun
    assert np.abs(picture[row, right] - photo[row, right]).max() <= 1
    ball = pixels(page, ".balls figure:nth-child(3) canvas")
    assert ball[100, 150, 0] > 100 > ball[100, 40, 0]


def test_the_object_moves_by_pointer_and_by_keys(show: Callable[..., "Page"]) -> None:
    page = show(torch.full((64, 128, 3), 0.6))
    page.get_by_label("Object", exact=True).select_option("box")
    canvas = page.locator("canvas.composite")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box is not None
    scale = box["width"] / SIZE
    x, y = box["x"] + FOOT[0] * scale, box["y"] + (FOOT[1] - HEIGHT / 2) * scale
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 256 * scale, y, steps=4)
    page.mouse.up()
    picture, photo = finished(page, 1 / 64)[..., :3], photo_pixels(page)
    row, column = round(FOOT[1] - HEIGHT / 2), round(FOOT[0])
    assert np.abs(picture[row, column] - photo[row, column]).max() <= 1
    assert np.ptp(picture[row - 8 : row + 8, column - 264 : column - 248], axis=(0, 1)).max() < 25

    canvas.focus()
    page.keyboard.press("ArrowRight")
    status = page.locator("[role=status]", has_text="metres away")
    for key in ("ArrowUp", "+", "."):
        before = status.text_content() or ""
        page.keyboard.press(key)
        expect(status).not_to_have_text(before)


def test_a_model_of_ones_own_stays_in_the_page(show: Callable[..., "Page"], tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    page = show(torch.full((64, 128, 3), 0.6))
    box = trimesh.creation.box((1, 1, 1))
    grey = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[0, 255, 0, 255], metallicFactor=0.0, roughnessFactor=1.0
    )
    box.visual = trimesh.visual.TextureVisuals(material=grey)
    box.export(tmp_path / "box.glb")
    (tmp_path / "tall.obj").write_text(trimesh.exchange.obj.export_obj(box, include_texture=False))
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    choose = page.locator("input[type=file][accept='.obj,.glb']")
    column, row = round(FOOT[0]), round(FOOT[1] - HEIGHT / 2)

    choose.set_input_files(tmp_path / "box.glb")
    page.locator("option[value=file]", has_text="box.glb").wait_for(state="attached")
    red, green, blue = finished(page, 1 / 64)[row, column, :3]
    assert green > 120 > 80 > max(red, blue)
    choose.set_input_files(tmp_path / "tall.obj")
    page.locator("option[value=file]", has_text="tall.obj").wait_for(state="attached")

    for name, content in {"broken.glb": b"glTF", "empty.obj": b"# nothing\n"}.items():
        (tmp_path / name).write_bytes(content)
        choose.set_input_files(tmp_path / name)
        page.get_by_role("alert").get_by_text(name).wait_for()
    assert not [url for url in asked if not url.startswith("blob:")]


def test_other_pages_offer_a_found_light_until_its_photo_goes(
    show: Callable[..., "Page"], tmp_path: Path
) -> None:
    page = show(torch.full((64, 128, 3), 0.6))
    found = page.get_by_label("Light", exact=True).locator("option", has_text="Found: photo.png")

    def offers(count: int) -> None:
        page.evaluate("location.hash = '#/codes'")
        page.get_by_role("heading", level=1, name="Sparse codes").wait_for()
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
    again = page.get_by_role("button", name="Find this light too")
    again.click()
    page.get_by_role("alert").get_by_text("The studio does not answer").wait_for()
    expect(again).to_be_enabled()
    expect(page.locator(".result")).to_have_count(1)
