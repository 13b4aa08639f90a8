"""The portrait of an estimate with its key light dragged, in a real browser.

The person was taken apart by the test, as the server's worker does; the page is the real one.
"""

import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from jaxtyping import Int
from PIL import Image

from skylight.io._tensors import read_tensors, write_tensors
from skylight.portrait._files import relit_portrait, shown, taken_apart
from skylight.portrait._gain import resized
from skylight.portrait._keys import (
    KEY_OVER_FILL,
    KEYS,
    SOFT_DEG,
    USUAL_DEG,
    key_light,
)
from tests.studio.browser.pictures import pixels
from tests.studio.browser.test_browser import LINE, picture
from tests.studio.browser.test_browser_access import CONTRASTS, NAMELESS, OVERFLOW
from tests.studio.browser.waiting import expect
from tests.studio.tasks.taken_apart import PHOTO, apart

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page

MOVE = "Relight the portrait"
CANVAS = ".relit"
_SHOWS = """wanted => {
    const shown = JSON.parse(document.querySelector(".relit")?.dataset.shows ?? "[]");
    return shown.length > 0 && wanted.every((x, k) => Math.abs(x - shown[k]) < 1e-6);
}"""


@pytest.fixture
def found(show: Callable[..., "Page"], tmp_path: Path) -> "Page":
    """A page with an estimate, whose person in the sun can be taken apart."""
    shutil.copy(apart().file, tmp_path)
    return show(torch.full((64, 128, 3), 0.5), accept_downloads=True)


def opened(page: "Page") -> None:
    page.get_by_role("tab", name="Portrait").click()
    page.locator(f"{CANVAS}[data-shows]").wait_for()


def key(page: "Page") -> tuple[float, float, float, float]:
    """Azimuth and zenith in the map, strength and width (degrees), as the canvas shows them."""
    told = page.evaluate("() => document.querySelector('.relit').dataset.shows")
    azimuth, zenith, strength, size = json.loads(told)
    return azimuth, zenith, strength, size


def relit(page: "Page") -> Int[np.ndarray, "h w 3"]:
    """The canvas, once it has all of the picture's pixels."""
    width = read_tensors(apart().file)[0]["picture"].shape[1]
    page.wait_for_function("width => document.querySelector('.relit').width === width", arg=width)
    return pixels(page, CANVAS)[..., :3].astype(int)


def drag_to(page: "Page", azimuth_deg: float, elevation_deg: float) -> None:
    """The key light to about that place of the panorama."""
    handle = page.get_by_role("button", name="Key light: ")
    frame = page.locator(".relit-grid .panorama")
    handle.scroll_into_view_if_needed()
    box, around = handle.bounding_box(), frame.bounding_box()
    assert box is not None
    assert around is not None
    x = around["x"] + (azimuth_deg / 360 + 0.5) * around["width"]
    y = around["y"] + (0.5 - elevation_deg / 180) * around["height"]
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(x, y, steps=8)
    page.mouse.up()
    page.wait_for_function(
        """([a, e]) => {
            const shows = document.querySelector(".relit").dataset.shows;
            const [azimuth, zenith] = JSON.parse(shows);
            return Math.abs(azimuth - a) < 2 && Math.abs(90 - zenith - e) < 2;
        }""",
        arg=[azimuth_deg, elevation_deg],
    )


def test_the_key_is_dragged_and_the_person_follows_as_the_command_has_it(
    found: "Page", tmp_path: Path, pictures: Path
) -> None:
    page = found
    opened(page)
    expect(page.get_by_role("button", name="Key light: ")).to_be_focused()
    as_found, first = key(page), relit(page)
    assert as_found == pytest.approx((-130.0, 60.0, KEY_OVER_FILL, USUAL_DEG))  # from the left

    # as the command, wherever the light is; and how far that is from the photograph
    result = apart().result
    portrait = taken_apart(result)
    seen = result.photos[0].encoded.astype(int)
    person = portrait.matte > 0.5
    skin = person & (resized(portrait.on.bare, seen.shape[:2]) > 0.5)
    behind = read_tensors(apart().file)[0]["picture"][..., 3].numpy() == 0
    sides = []
    for azimuth, elevation in ((-110.0, 30.0), (120.0, 55.0), (10.0, 40.0)):
        drag_to(page, azimuth, elevation)
        now, (there, zenith, *_) = relit(page), key(page)
        light = key_light(result.estimate, (180.0 - there, 90.0 - zenith))
        want = shown(relit_portrait(result, light, keep="place", portrait=portrait)).astype(int)
        assert np.abs(now - want)[skin].mean() < 3, azimuth
        assert np.abs(now - want)[person].mean() < 3, azimuth
        np.testing.assert_array_equal(now[behind], seen[behind])
        assert np.abs(want - seen)[skin].mean() > 6, azimuth
        columns = np.nonzero(skin)[1]
        left = skin & (np.arange(skin.shape[1]) < np.median(columns))
        sides.append(now[left].mean() - now[skin & ~left].mean())
    assert sides[0] > 10 > -10 > sides[1]  # the bright side is the light's

    # by keys, by a degree and by ten; said by a screen reader's words
    azimuth, zenith, *usual = key(page)
    page.get_by_role("button", name="Key light: ").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowUp")
    page.wait_for_function(_SHOWS, arg=[azimuth - 1, zenith - 10, *usual])
    page.get_by_role("status").get_by_text("azimuth").wait_for()

    # by name; without it the picture is flat, and the command says so too
    for name, (to_right, elevation) in KEYS.items():
        page.get_by_role("button", name=name.capitalize(), exact=True).click()
        turned = (180.0 - to_right + 180.0) % 360.0 - 180.0
        page.wait_for_function(_SHOWS, arg=[turned, 90.0 - elevation, *usual])
    page.get_by_label("Softness").fill(str(SOFT_DEG))
    page.wait_for_function(_SHOWS, arg=[turned, 90.0 - elevation, KEY_OVER_FILL, SOFT_DEG])
    page.get_by_label("Strength").fill("0")
    page.wait_for_function(
        "() => JSON.parse(document.querySelector('.relit').dataset.shows)[2] === 0"
    )
    words = shlex.split(page.locator(".command code").text_content() or "")
    assert words[:3] == ["skylight", "relight-portrait", PHOTO]
    assert "--light" in words
    assert words[words.index("--strength") + 1] == "0"
    assert words[words.index("--size") + 1] == "40"
    assert f"--angle={to_right:.1f},{elevation:.1f}" in words

    # before and after, while a button is held; saved as it is seen
    hold = page.get_by_role("button", name="Hold: as photographed")
    after = relit(page)
    hold.focus()
    page.keyboard.down("Space")
    expect(hold).to_have_attribute("aria-pressed", "true")
    np.testing.assert_array_equal(relit(page), seen)
    page.keyboard.up("Space")
    expect(hold).to_have_attribute("aria-pressed", "false")
    np.testing.assert_array_equal(relit(page), after)
    page.get_by_label("Before and after").fill("50")
    half = relit(page)
    middle = half.shape[1] // 2
    np.testing.assert_array_equal(half[:, : middle - 1], seen[:, : middle - 1])
    np.testing.assert_array_equal(half[:, middle + 1 :], after[:, middle + 1 :])
    with page.expect_download() as download:  # all of it
        page.locator(".relit-grid").get_by_role("button", name="Save this picture").click()
    assert download.value.suggested_filename == "relit.png"
    download.value.save_as(tmp_path / "relit.png")
    saved = np.asarray(Image.open(tmp_path / "relit.png").convert("RGB")).astype(int)
    np.testing.assert_array_equal(saved, after)  # the estimate is reliable: no line below

    page.get_by_role("button", name="Reset", exact=True).click()
    page.wait_for_function(_SHOWS, arg=list(as_found))
    np.testing.assert_array_equal(relit(page), first)
    assert page.locator(".command code").text_content().count("--strength") == 0  # type: ignore[union-attr]

    # for everybody
    assert page.evaluate(NAMELESS) == []
    texts = [text for ratio, text in page.evaluate(CONTRASTS) if ratio < 4.5]
    assert [text for text in texts if "lamp-handle" not in text] == []  # white on the panorama
    drag_to(page, -110.0, 30.0)
    picture(page, pictures / "studio_relit.png")
    page.set_viewport_size({"width": 360, "height": 740})
    page.wait_for_function("innerWidth === 360")
    assert page.evaluate(OVERFLOW) == 0


def test_while_the_light_moves_only_what_the_screen_shows_is_drawn(found: "Page") -> None:
    page = found
    opened(page)
    page.locator(".relit-grid figure").first.evaluate("all => { all.style.width = '160px'; }")
    as_found, before = key(page), relit(page)
    page.evaluate(
        """() => {
            const canvas = document.querySelector(".relit");
            window.sizes = [];
            const look = () => sizes.push([canvas.width, canvas.clientWidth, canvas.clientHeight]);
            look();
            new MutationObserver(look).observe(canvas, { attributeFilter: ["data-shows"] });
        }"""
    )
    page.keyboard.press("Shift+ArrowLeft")
    page.keyboard.press("Shift+ArrowRight")
    page.wait_for_function("() => sizes.length > 1")
    page.wait_for_function(_SHOWS, arg=list(as_found))
    np.testing.assert_array_equal(relit(page), before)
    (full, *shown), *moving = page.evaluate("() => sizes")
    assert 0 < shown[0] < full
    for width, *still in moving:
        assert 0 < width <= shown[0]
        assert still == shown


def test_a_warning_is_shown_and_saved_with_the_picture(found: "Page", tmp_path: Path) -> None:
    tensors, metadata = read_tensors(apart().file)
    facts = json.loads(metadata["facts"]) | {
        "warning": "the light that was found is unreliable",
        "is_alone": False,
    }
    write_tensors(tmp_path / apart().file.name, tensors, {"facts": json.dumps(facts)})
    page = found
    opened(page)
    figure = page.locator(".relit-grid figure").first
    expect(figure.get_by_text("Take care: the light that was found is unreliable.")).to_be_visible()
    page.get_by_text("At full resolution", exact=True).click()
    expect(page.get_by_text("the light of this face alone")).to_be_visible()
    with page.expect_download() as download:
        page.locator(".relit-grid").get_by_role("button", name="Save this picture").click()
    download.value.save_as(tmp_path / "relit.png")
    saved = np.asarray(Image.open(tmp_path / "relit.png").convert("RGB")).astype(int)
    height = len(relit(page))
    np.testing.assert_array_equal(saved[:height], relit(page))
    line = saved[height:]
    assert len(line) == 20
    assert line[0, 0].tolist() == [40, 40, 40]
    assert (line[..., 0] > 200).any()  # yellow letters


def test_an_estimate_that_is_gone_is_told_in_one_line(found: "Page") -> None:
    page = found
    page.unroute("**/api/jobs")  # the server knows of no such job
    page.get_by_role("tab", name="Portrait").click()
    alert = page.locator(f".relit-section {LINE}")
    expect(alert).to_have_text("There is no such job (any more); begin again")
    expect(page.get_by_role("button", name=MOVE)).to_be_enabled()
