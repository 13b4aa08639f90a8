"""The page for everybody: by keyboard alone, on narrow screens, in both colour schemes."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import pytest
import torch
from PIL import Image
from skimage.data import astronaut

from tests.studio.browser.known_light import answers
from tests.studio.browser.waiting import expect

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page

LIGHT = torch.full((64, 128, 3), 0.6)
OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"

# what has the focus: its kind, its name, and whether one sees that it has it
_FOCUSED = """() => {
    const it = document.activeElement;
    const words = it.getAttribute("aria-label") ?? it.labels?.[0]?.textContent ?? it.textContent;
    const style = getComputedStyle(it);
    const seen = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2;
    return [it.localName, words.trim(), seen];
}"""

# everything that can be used, shown, and not by Tab skipped on purpose (a group's other radios)
_USABLE = """() => [...document.querySelectorAll("a[href], button, select, input, [tabindex='0']")]
    .filter((it) => it.checkVisibility() && !it.disabled && (it.type !== "radio" || it.checked))
    .length"""

NAMELESS = """() => [...document.querySelectorAll(
        "canvas, img, svg[role=img], select, input, button, summary, a[href]")]
    .filter((it) => it.checkVisibility())
    .filter((it) => !(it.getAttribute("aria-label") || it.alt))
    .filter((it) => !(it.labels?.length || it.textContent.trim()))
    .map((it) => it.outerHTML)"""

# the ratio of WCAG 2 between the colour of each piece of text and what lies behind it
CONTRASTS = """() => {
    const canvas = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
    const rgba = (color) => {
        canvas.clearRect(0, 0, 1, 1);
        canvas.fillStyle = color;
        canvas.fillRect(0, 0, 1, 1);
        return [...canvas.getImageData(0, 0, 1, 1).data].map((value) => value / 255);
    };
    const level = (color) => {
        const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
        const [r, g, b] = rgba(color).map(linear);
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const behind = (it) => {
        const color = getComputedStyle(it).backgroundColor;
        return rgba(color)[3] > 0.99 || !it.parentElement ? color : behind(it.parentElement);
    };
    const found = [];
    for (const it of document.querySelectorAll("body *")) {
        const isText = [...it.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
        if (!isText || !it.checkVisibility() || it.disabled) continue;
        if (it.matches(".face-box, .skip, .visually-hidden, option")) continue;
        const [a, b] = [level(getComputedStyle(it).color), level(behind(it))].sort((x, y) => y - x);
        found.push([(a + 0.05) / (b + 0.05), it.outerHTML.slice(0, 100)]);
    }
    return found;
}"""


def press_until(page: "Page", name: str, key: str = "Tab") -> None:
    """Presses until the element of that name has the focus, which must be visible."""
    for _ in range(40):
        page.keyboard.press(key)
        _, words, seen = page.evaluate(_FOCUSED)
        if words.startswith(name):
            assert seen, name
            return
    raise AssertionError(f"no {name!r} by {key}")


def test_the_keyboard_is_enough(new_page: Callable[..., "Page"], tmp_path: Path) -> None:
    page = new_page()
    Image.fromarray(astronaut()).save(tmp_path / "photo.png")
    # from the start: the driver takes its time to listen
    page.on("filechooser", lambda chooser: chooser.set_files(tmp_path / "photo.png"))
    press_until(page, "Skip to the content")
    page.keyboard.press("Enter")
    expect(page.locator("#main")).to_be_focused()
    press_until(page, "Choose a photo")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="The face").wait_for()
    for pattern in ("**/api/jobs/**", "**/api/jobs"):
        page.route(pattern, answers(LIGHT, tmp_path))
    press_until(page, "The face")
    page.keyboard.press("Space")
    press_until(page, "Decide for me")
    press_until(page, "Indoors", "ArrowDown")
    press_until(page, "More")
    page.keyboard.press("Enter")
    press_until(page, "Model of the light")
    press_until(page, "Find the light")
    page.keyboard.press("Enter")
    verdict = page.get_by_role("heading", name="Hard light from the left")
    expect(verdict).to_be_focused()  # it is read first
    press_until(page, "Objects", "Shift+Tab")
    press_until(page, "Your photo with the object")
    page.keyboard.press("ArrowLeft")
    page.get_by_role("status").get_by_text("metres away").wait_for()
    press_until(page, "Turn")
    turn = page.get_by_label("Turn", exact=True)
    before = turn.input_value()
    page.keyboard.press("ArrowRight")
    expect(turn).not_to_have_value(before)
    reached = everything(page)
    for words in ("Choose a photo", "Your own model", "Save this picture", "Map .exr"):
        assert any(name.startswith(words) for name in reached), words

    press_until(page, "Objects")
    page.keyboard.press("End")
    expect(page.get_by_role("tab", name="Result")).to_be_focused()
    press_until(page, "probe.exr")
    press_until(page, "Result", "Shift+Tab")
    page.keyboard.press("ArrowLeft")
    expect(page.get_by_role("tab", name="Map")).to_have_attribute("aria-selected", "true")
    press_until(page, "Ball of all directions")
    page.keyboard.press("ArrowRight")
    assert "Exposure of the views" in everything(page)


def everything(page: "Page") -> set[str]:
    """The names of all that Tab reaches, from the top of the page; nothing has none."""
    page.evaluate("document.activeElement.blur(); scrollTo(0, 0)")
    reached: set[str] = set()
    for _ in range(page.evaluate(_USABLE) + 3):
        page.keyboard.press("Tab")
        reached.add(page.evaluate(_FOCUSED)[1])
    assert page.evaluate(NAMELESS) == []
    return reached


@pytest.mark.parametrize("width", [360, 700])
def test_nothing_is_wider_than_the_screen(show: Callable[..., "Page"], width: int) -> None:
    page = show(LIGHT, viewport={"width": width, "height": 740}, has_touch=True)
    for tab in ("Photo", "Objects", "Portrait", "Map", "Result"):
        page.get_by_role("tab", name=tab).click()
        assert page.evaluate(OVERFLOW) == 0, tab
    for name in ("sky", "codes", "voxel", "partitions"):
        page.evaluate("name => { location.hash = `#/${name}`; }", name)
        page.locator(f"nav a[href='#/{name}'][aria-current=page]").wait_for()
        page.locator("h1").wait_for()
        assert page.evaluate(OVERFLOW) == 0, name


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out(show: Callable[..., "Page"], scheme: Literal["light", "dark"]) -> None:
    page = show(LIGHT, color_scheme=scheme, reduced_motion="reduce")
    choose = page.locator("input[type=file][accept='.obj,.glb']")
    choose.set_input_files({"name": "x.obj", "mimeType": "", "buffer": b"# empty"})
    page.locator("[role=alert] .alert").wait_for()
    for tab, least in (("Objects", 30), ("Photo", 20), ("Map", 20), ("Result", 30)):
        page.get_by_role("tab", name=tab).click()
        contrasts = page.evaluate(CONTRASTS)
        assert len(contrasts) > least, tab
        assert [(ratio, text) for ratio, text in contrasts if ratio < 4.5] == [], tab
