"""A studio that runs, and pages of it in a real Chromium; skipped where there is none."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest
from PIL import Image
from skimage.data import astronaut
from torch import Tensor

from tests.studio.browser.known_light import answers

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
# everything that a page could leave on the machine
_KEPT = """async () => [
    localStorage.length + sessionStorage.length,
    document.cookie,
    (await indexedDB.databases()).length,
    (await caches.keys()).length,
    (await navigator.serviceWorker.getRegistrations()).length,
]"""


@pytest.fixture(scope="session")
def chromium() -> "Iterator[Browser]":
    """A headless Chromium of this machine: the first on the path, or SKYLIGHT_CHROMIUM."""
    driver = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    named = os.environ.get("SKYLIGHT_CHROMIUM")
    found = named or next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        pytest.skip("no Chromium on the path: install one, or name it in SKYLIGHT_CHROMIUM")
    with driver.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def studio_address() -> Iterator[str]:
    """The address of a studio that takes one job at a time, and small uploads."""
    limits = ["--jobs", "1", "--upload-mb", "3", "--megapixels", "2"]
    command = [sys.executable, "-m", "skylight", "studio", "--no-browser", "--port", "0", *limits]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


@pytest.fixture
def new_page(chromium: "Browser", studio_address: str) -> "Iterator[Callable[..., Page]]":
    """Makes pages of the studio, each with nothing kept from the others.

    At the end each is looked at: it asked no other machine for anything, kept nothing, and no
    script of it failed.
    """
    pages: list[Page] = []
    asked: list[str] = []
    failed: list[str] = []

    def make(path: str = "/", **options: Any) -> "Page":
        context = chromium.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        page = context.new_page()
        pages.append(page)
        page.set_default_timeout(60_000)
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
        assert (kept, cookies) == ([0, "", 0, 0, 0], [])
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
    """Makes a page that has found the given light, (64, 128, 3), in a photo of one face."""

    def shown(radiance: Tensor, **options: Any) -> "Page":
        page = new_page(**options)
        answer = answers(radiance, tmp_path)
        page.route("**/api/jobs/**", answer)
        page.route("**/api/jobs", answer)
        picture = astronaut().copy()
        picture[300:] = 160  # even ground for shadows
        Image.fromarray(picture).save(tmp_path / "photo.png")
        page.set_input_files("input[type=file]", tmp_path / "photo.png")
        page.get_by_role("button", name="Find the light").click()
        page.wait_for_selector(".composite[data-share]:not([data-share='0'])")
        return page

    return shown
