"""A page of `skylight export viewer` in a browser that reaches no network."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from tests.studio.browser.waiting import PATIENCE_MS

CHROMIUM = shutil.which("chromium") or "chromium"


@contextmanager
def opened(page: Path, chromium: str = CHROMIUM) -> Iterator[Page]:
    """The page, 1280 pixels wide; ends the run where it had an error."""
    errors: list[str] = []
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium)
        context = browser.new_context(viewport={"width": 1280, "height": 900}, offline=True)
        shown = context.new_page()
        shown.set_default_timeout(PATIENCE_MS)
        shown.on("pageerror", lambda error: errors.append(str(error)))
        shown.goto(page.as_uri())
        try:
            yield shown
        finally:
            browser.close()
            if errors:
                raise SystemExit(f"{page.name}: {errors[0]}")
