"""What tests of a page wait for; none reads at once what the page may still be about to change."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page
    from playwright.sync_api._generated import LocatorAssertions

PATIENCE_MS = 180_000  # the machine may have other things to do


def expect(shown: "Locator") -> "LocatorAssertions":
    """What must become true of it, sooner or later."""
    from playwright.sync_api import expect as assertions  # here: tests skip where it is missing

    return assertions(shown)


def painted(page: "Page") -> None:
    """Waits until everything is painted that was asked for: what a new size asks for, too."""
    page.evaluate(
        "() => new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))"
    )


def gathered(page: "Page", share: float) -> None:
    """Waits until that share of its light has come to the object in the photo."""
    page.wait_for_function(
        "share => document.querySelector('.composite')?.dataset.share >= share", arg=share
    )
