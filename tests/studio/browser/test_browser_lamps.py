"""An estimate's lamps, moved and switched in a real browser."""

import re
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from skimage.data import astronaut

from tests.studio.browser.test_browser import choose_photo, estimated, picture
from tests.studio.browser.test_browser_access import CONTRASTS, NAMELESS, OVERFLOW
from tests.studio.browser.test_browser_light import pixels
from tests.studio.browser.waiting import expect, painted

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page, Request

FACE = ".lamp-face"


def relit(page: "Page") -> np.ndarray:
    """The right half of the picture of faces, once it is that of the lamps as they are now."""
    wanted = page.get_by_role("link", name="edited probe.exr").get_attribute("href") or ""
    query = wanted.partition("?")[2].removesuffix("&download=true")
    page.wait_for_function(
        "query => (document.querySelector('.lamp-face').dataset.shows ?? '').endsWith(query)",
        arg=query,
    )
    painted(page)
    shown = pixels(page, FACE)
    return shown[:, shown.shape[1] // 2 :, :3]


def angle(page: "Page", column: str) -> float:
    """Of the first lamp, as the table has it."""
    heads = page.locator(".lamps thead th").all_text_contents()
    cell = page.locator(".lamps tbody tr").first.locator("td, th").nth(heads.index(column))
    return float((cell.text_content() or "").removesuffix("°"))


def test_lamps_are_moved_switched_saved_and_reset(
    new_page: Callable[..., "Page"], studio_address: str, tmp_path: Path, pictures: Path
) -> None:
    page = new_page(accept_downloads=True)
    Image.fromarray(astronaut()).save(tmp_path / "portrait.png")
    choose_photo(page, tmp_path / "portrait.png")
    lamps = estimated(page, "lamps")["result"]["lamps"]
    page.get_by_role("tab", name="Map").click()
    first = relit(page)
    handles = page.get_by_role("button", name=re.compile("^Lamp [1-9]"))
    assert lamps
    expect(handles).to_have_count(len(lamps))
    assert angle(page, "Azimuth") == pytest.approx(lamps[0]["azimuth_deg"], abs=0.06)
    assert angle(page, "Zenith") == pytest.approx(lamps[0]["zenith_deg"], abs=0.06)

    # dragged: face and panorama follow, with one request at a time
    under_way: set[Request] = set()
    most: list[int] = []

    def begun(request: "Request") -> None:
        if "/lamps/" in request.url:
            under_way.add(request)
            most.append(len(under_way))

    page.on("request", begun)
    page.on("requestfinished", lambda request: under_way.discard(request))
    handle, panorama = handles.first, page.locator(".panorama")
    handle.scroll_into_view_if_needed()
    box, frame = handle.bounding_box(), panorama.bounding_box()
    assert box is not None
    assert frame is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    before = pixels(page, ".panorama canvas")[..., :3]
    sideways = -90 if x > frame["x"] + frame["width"] / 2 else 90
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + sideways, y, steps=30)
    page.mouse.up()
    dragged = relit(page)
    want = lamps[0]["azimuth_deg"] + 360 * sideways / frame["width"]
    assert angle(page, "Azimuth") == pytest.approx(want, abs=1)
    assert angle(page, "Zenith") == pytest.approx(lamps[0]["zenith_deg"], abs=1)
    assert len(most) > 1
    assert max(most) == 1
    assert np.abs(dragged - first).max() > 10
    after = pixels(page, ".panorama canvas")[..., :3]
    assert np.abs(after - before).max() > 20
    picture(page, pictures / "studio_lamps.png")

    # by keys, by a degree each
    azimuth, zenith = angle(page, "Azimuth"), angle(page, "Zenith")
    handle.focus()
    for key in ("ArrowRight", "ArrowUp", "ArrowUp"):
        page.keyboard.press(key)
    assert angle(page, "Azimuth") == pytest.approx(azimuth + 1, abs=0.11)
    assert angle(page, "Zenith") == pytest.approx(zenith - 2, abs=0.11)
    page.get_by_role("status").get_by_text(re.compile("azimuth .*, zenith ")).wait_for()

    # switched: without lamps it is darker, without ambient light black; the map is saved as it is
    for number in range(1, len(lamps) + 1):
        page.get_by_label(f"Lamp {number} on").uncheck()
    ambient = relit(page)
    page.get_by_label("Ambient on").uncheck()
    dark = relit(page)
    assert first.mean() > ambient.mean() + 2 > dark.mean() + 4
    page.get_by_label("Lamp 1 on").check()
    relit(page)
    link = page.get_by_role("link", name="edited probe.exr")
    with page.expect_download() as download:
        link.click()
    assert download.value.suggested_filename == "edited_probe.exr"
    download.value.save_as(tmp_path / "edited.exr")
    with urllib.request.urlopen(f"{studio_address}{link.get_attribute('href')}") as answer:
        assert (tmp_path / "edited.exr").read_bytes() == answer.read()

    page.get_by_role("button", name="Reset to the estimate").click()
    np.testing.assert_array_equal(relit(page), first)
    expect(page.get_by_label("Ambient on")).to_be_checked()
    assert angle(page, "Azimuth") == pytest.approx(lamps[0]["azimuth_deg"], abs=0.06)

    # for everybody; and nothing of it where no lamp was found
    assert page.evaluate(NAMELESS) == []
    texts = [text for ratio, text in page.evaluate(CONTRASTS) if ratio < 4.5]
    assert [text for text in texts if "lamp-handle" not in text] == []  # white on the panorama
    estimated(page, "sh9")
    expect(page.get_by_label("Light shown").locator("option")).to_have_count(2)
    expect(page.get_by_label("Lamps to move and switch")).to_have_count(0)
    page.set_viewport_size({"width": 360, "height": 740})
    page.wait_for_function("innerWidth === 360")
    assert page.evaluate(OVERFLOW) == 0
