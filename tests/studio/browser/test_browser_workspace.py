"""A photo and its light in one view: what is in sight, what a reload keeps, what is taken back."""

import json
import re
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
import torch

from tests.studio.browser.composite_page import choose, placement
from tests.studio.browser.waiting import expect

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

LIGHT = torch.full((64, 128, 3), 0.6)
# levels of headings in sight, in their order
_HEADINGS = """() => [...document.querySelectorAll("h1, h2, h3, h4, h5, h6")]
    .filter((it) => it.checkVisibility()).map((it) => Number(it.localName[1]))"""
_KEPT = "() => sessionStorage.getItem('skylight studio')"
_UNDER = """it => {
    const { left, top, width, height } = it.getBoundingClientRect();
    return it.contains(document.elementFromPoint(left + width / 2, top + height / 2));
}"""


def in_sight(page: "Page", shown: "Locator") -> None:
    """All of it is on the screen, without scrolling, and nothing lies over its middle."""
    expect(shown).to_be_visible()
    box, size = shown.bounding_box(), page.viewport_size
    assert box is not None
    assert size is not None
    words = shown.evaluate("it => it.outerHTML.slice(0, 80)")
    assert box["x"] >= 0, words
    assert box["y"] >= 0, words
    assert box["x"] + box["width"] <= size["width"] + 0.5, words
    assert box["y"] + box["height"] <= size["height"] + 0.5, words
    assert shown.evaluate(_UNDER), words


def verdict(page: "Page") -> "Locator":
    return page.get_by_role("region", name="Verdict")


def downloads(page: "Page") -> "Locator":
    return page.get_by_role("region", name="Downloads")


def key_lights(page: "Page") -> "Locator":
    return page.get_by_role("group", name="Key light from")


def test_a_desk_shows_all_of_it_at_once(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT, viewport={"width": 1280, "height": 800})
    parts = (
        page.locator("canvas.composite"),
        page.locator(".side .panorama"),
        verdict(page),
        downloads(page),
        key_lights(page),
        page.get_by_label("Object", exact=True),
        page.get_by_role("tabpanel", name="Objects").get_by_role("button", name="Save"),
    )
    for part in parts:
        in_sight(page, part)
    assert page.evaluate("() => document.documentElement.scrollHeight") <= 800
    for tab in ("Photo", "Objects", "Map", "Result"):
        page.get_by_role("tab", name=tab).click()
        in_sight(page, verdict(page))
        levels = page.evaluate(_HEADINGS)
        assert levels[0] == 1
        assert all(b - a <= 1 for a, b in pairwise(levels)), tab
        assert page.locator("h1:visible").count() == 1


def test_a_phone_has_it_under_a_thumb(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT, viewport={"width": 390, "height": 844}, has_touch=True)
    tabs = page.get_by_role("tablist")
    in_sight(page, tabs)
    assert page.viewport_size is not None
    box = tabs.bounding_box()
    assert box is not None
    assert box["y"] + box["height"] == pytest.approx(844, abs=1)  # at the bottom, on every tab
    in_sight(page, verdict(page))
    in_sight(page, page.locator("canvas.composite"))
    page.get_by_role("tab", name="Result").click()
    for part in (verdict(page), page.locator(".side .panorama"), downloads(page), key_lights(page)):
        in_sight(page, part)


def test_questions_name_the_place(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT)
    page.get_by_role("tab", name="Photo").click()
    places = page.get_by_role("group", name="Where was it taken?").get_by_role("radio")
    assert [one.get_attribute("value") for one in places.all()] == [
        "auto",
        "outdoors",
        "indoors",
        "flash",
    ]
    expect(page.get_by_label("Model of the light")).to_be_hidden()
    page.get_by_label("Flash").check()
    with page.expect_request("**/api/jobs") as asked:
        page.get_by_role("button", name="Find this light too").click()
    body = json.loads(asked.value.post_data or "")
    assert (body["place"], body["light"]) == ("flash", "sphere")
    options = page.get_by_label("Light shown").locator("option")
    expect(options).to_have_text(["Any place, all round", "Any place, all round, flash"])


def test_changes_are_taken_back_and_made_again(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT)
    undo, redo = (page.get_by_role("button", name=name) for name in ("Undo", "Redo"))
    expect(undo).to_be_disabled()
    first = placement(page)
    choose(page, "Object", "box")
    expect(undo).to_be_enabled()
    box = placement(page)
    page.locator("canvas.composite").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")  # both are one movement
    moved = placement(page)
    assert moved["foot"] != box["foot"]
    page.keyboard.press("Control+z")
    assert placement(page) == box
    expect(page.get_by_label("Object", exact=True)).to_have_value("box")
    page.get_by_role("tab", name="Map").click()
    page.keyboard.press("Control+z")
    expect(page.get_by_label("Object", exact=True)).to_have_value("balls")  # and it is in sight
    assert placement(page) == first
    expect(undo).to_be_disabled()
    page.keyboard.press("Control+y")
    page.keyboard.press("Control+Shift+z")
    assert placement(page) == moved
    expect(redo).to_be_disabled()


def test_a_reload_loses_nothing(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT)
    choose(page, "Surface", "mirror")
    choose(page, "Object", "box")
    expect(page.get_by_role("button", name="Undo")).to_be_enabled()
    before = placement(page)
    page.get_by_role("tab", name="Result").click()
    expect(page.locator(".kept")).to_contain_text("a reload loses nothing")
    told = page.evaluate(_KEPT)
    assert len(told) < 5000  # names and numbers
    page.reload()
    expect(page.get_by_role("tab", name="Result")).to_have_attribute("aria-selected", "true")
    expect(verdict(page)).to_contain_text("Hard light from the left")
    page.get_by_role("tab", name="Objects").click()
    expect(page.get_by_label("Object", exact=True)).to_have_value("box")
    expect(page.get_by_label("Surface")).to_have_value("mirror")
    assert placement(page) == before
    expect(page.get_by_role("button", name="Undo")).to_be_disabled()  # it begins here


def test_a_closed_photo_is_forgotten(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(f"{request.method} {request.url}"))
    page.get_by_role("button", name="Close this photo").click()
    expect(page.get_by_role("button", name="Choose a photo")).to_be_focused()
    page.get_by_role("region", name="Try one of these").wait_for()
    assert page.evaluate(_KEPT) is None
    gone = [line for line in asked if line.startswith("DELETE")]
    assert sum("/api/jobs/it" in line for line in gone) == 1
    assert sum("/api/photos/" in line for line in gone) == 1
    page.reload()
    page.get_by_role("region", name="Try one of these").wait_for()
    expect(page.get_by_role("tab")).to_have_count(0)


def test_a_photo_that_the_studio_has_forgotten_is_asked_for(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT)
    line = {"error": "there is no such photo (any more); begin again"}
    page.route("**/preview.jpg", lambda route: route.fulfill(status=404, json=line))
    page.reload()
    alert = page.get_by_role("alert").filter(has_text="give the photo again")
    expect(alert).to_have_count(1)
    page.get_by_role("button", name="Choose a photo").wait_for()


def test_time_left_is_told_and_a_reload_goes_on_with_the_work(show: Callable[..., "Page"]) -> None:
    page = show(LIGHT)
    page.get_by_role("tab", name="Photo").click()
    told = {"job": "it", "kind": "estimate", "state": "running"}
    told |= {"stage": "estimating the light", "share": 0.5}
    body = f"data: {json.dumps(told)}\n\n"
    page.route(
        "**/events", lambda route: route.fulfill(body=body, content_type="text/event-stream")
    )
    page.get_by_role("button", name="Find this light too").click()
    expect(page.get_by_role("tabpanel", name="Photo").locator(".job .left")).to_have_text(
        re.compile("^(nearly done|about [0-9]+ s left)$")
    )
    page.unroute("**/events")  # it ends while the page is loaded again
    page.reload()
    lights = page.get_by_label("Light shown").locator("option")
    expect(lights).to_have_text(["Any place, all round", "Any place, all round (2)"])
    expect(page.get_by_role("heading", name="Hard light from the left")).to_be_focused()


def test_the_lab_has_what_is_beside_light_from_faces(new_page: Callable[..., "Page"]) -> None:
    page = new_page()
    pages = page.get_by_role("navigation", name="Pages")
    expect(pages.get_by_role("link")).to_have_text(["Light from a face", "Lab"])
    expect(page.get_by_role("navigation", name="Lab")).to_be_hidden()
    pages.get_by_role("link", name="Lab").click()
    page.get_by_role("heading", level=1, name="Lab").wait_for()
    assert page.evaluate("() => getComputedStyle(document.querySelector('main')).outlineStyle") == (
        "none"
    )
    for name in ("Make a sky", "Light in few pieces", "Voxel probe", "Partitions probe"):
        page.goto(page.url.partition("#")[0] + "#/lab")
        page.get_by_role("heading", level=2, name=name).get_by_role("link").click()
        page.get_by_role("heading", level=1, name=name).wait_for()
        here = page.get_by_role("navigation", name="Lab").get_by_role("link", name=name)
        expect(here).to_have_attribute("aria-current", "page")


@pytest.mark.parametrize("name", ["codes", "voxel", "partitions"])
def test_choices_stay_in_their_panels(new_page: Callable[..., "Page"], name: str) -> None:
    page = new_page(f"/#/{name}", viewport={"width": 1000, "height": 800})
    page.wait_for_function("() => [...document.querySelectorAll('select')].some((it) => it.length)")
    over = page.evaluate(
        """() => [...document.querySelectorAll(".card select")].map((it) =>
            it.getBoundingClientRect().right - it.closest(".card").getBoundingClientRect().right)"""
    )
    assert over
    assert max(over) < 0
