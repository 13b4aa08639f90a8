"""A studio that runs, and pages of it in a real Chromium; skipped where there is none."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from jaxtyping import UInt8
from PIL import Image
from skimage.data import astronaut
from torch import Tensor

from tests.studio.browser.known_light import EYES, answers, taken_photo
from tests.studio.browser.waiting import PATIENCE_MS, gathered, painted
from tests.studio.conftest import Served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
# everything that a page could leave on the machine; what the tab knows goes with it
_KEPT = """async () => [
    localStorage.length,
    Object.keys(sessionStorage).filter((key) => key !== "skylight studio").length,
    document.cookie,
    (await indexedDB.databases()).length,
    (await caches.keys()).length,
    (await navigator.serviceWorker.getRegistrations()).length,
]"""
NO_WEBGL = """
const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.startsWith("webgl") ? null : get.call(this, kind, ...more);
};"""
_PREVIEW_IS_IN = """() => {
    const preview = document.querySelector(".photo img");
    return preview?.complete && preview.naturalWidth > 0;
}"""


@pytest.fixture(scope="session")
def chromium() -> "Iterator[Browser]":
    """A headless Chromium of this machine: the first on the path, or SKYLIGHT_CHROMIUM."""
    driver = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    named = os.environ.get("SKYLIGHT_CHROMIUM")
    found = named or next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        pytest.skip("no Chromium on the path: install one, or name it in SKYLIGHT_CHROMIUM")
    driver.expect.set_options(timeout=PATIENCE_MS)
    with driver.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def studio(served: Served) -> Served:
    """That of all tests, which takes two jobs at a time, and small uploads."""
    return served


@pytest.fixture(scope="session")
def studio_address(studio: Served) -> str:
    return studio.address


@pytest.fixture
def new_page(chromium: "Browser", studio_address: str) -> "Iterator[Callable[..., Page]]":
    """Makes pages of the studio, each with nothing kept from the others.

    Without ``webgl`` none draws an object into a photo, which takes a processor longer than all
    else. At the end each is looked at: it asked no other machine for anything, kept nothing, and
    no script of it failed.
    """
    pages: list[Page] = []
    asked: list[str] = []
    failed: list[str] = []

    def make(path: str = "/", *, webgl: bool = True, **options: Any) -> "Page":
        context = chromium.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        page = context.new_page()
        if not webgl:
            page.add_init_script(NO_WEBGL)
        pages.append(page)
        page.set_default_timeout(PATIENCE_MS)
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: failed.append(str(error)))
        page.goto(studio_address + path)
        page.wait_for_selector("h1")
        return page

    yield make
    for page in pages:
        kept = page.evaluate(_KEPT)
        cookies = page.context.cookies()
        page.context.close()
        assert (kept, cookies) == ([0, 0, "", 0, 0, 0], [])
    assert not failed
    own = urlsplit(studio_address).netloc
    assert {urlsplit(url).netloc for url in asked if url[:5] not in ("blob:", "data:")} <= {own}


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where screenshots go: SKYLIGHT_STUDIO_PICTURES (the documentation's), or nowhere to stay."""
    named = os.environ.get("SKYLIGHT_STUDIO_PICTURES")
    folder = Path(named) if named else tmp_path_factory.mktemp("pictures")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture
def show(new_page: "Callable[..., Page]", tmp_path: Path) -> "Callable[..., Page]":
    """Makes a page that has found the given light, (64, 128, 3), in a photo of one face.

    Below its row 300 the photo is even ground; another one is shown as if the face had been found.
    """

    def shown(
        radiance: Tensor,
        eyes: tuple[float, float, float] = EYES,
        photo: UInt8[np.ndarray, "h w 3"] | None = None,
        **options: Any,
    ) -> "Page":
        page = new_page(**options)
        page.get_by_role("region", name="Try one of these").wait_for()  # what is below stays there
        answer = answers(radiance, tmp_path, eyes)
        page.route("**/api/jobs/**", answer)
        page.route("**/api/jobs", answer)
        picture = astronaut().copy() if photo is None else photo
        if photo is None:
            picture[300:] = 160  # even ground for shadows
        Image.fromarray(picture).save(tmp_path / "photo.png")
        if photo is not None:
            taken = taken_photo(tmp_path / "photo.png", eyes)
            page.route("**/api/photos?*", taken)
            page.route("**/api/photos/**", taken)
        page.set_input_files("input[type=file]", tmp_path / "photo.png")
        page.wait_for_function(_PREVIEW_IS_IN)
        page.get_by_role("button", name="Find the light").click()
        gathered(page, 1 / 64)
        painted(page)
        return page

    return shown
