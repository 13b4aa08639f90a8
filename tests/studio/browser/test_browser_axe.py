"""axe-core, the usual checker of WCAG's rules, finds no fault on any page.

Skipped where studio/node_modules has it not: ``cd studio && npm ci``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import pytest
import torch

from tests.studio.browser.waiting import expect

if TYPE_CHECKING:
    from playwright.sync_api import Page

AXE = Path(__file__).parents[3] / "studio" / "node_modules" / "axe-core" / "axe.min.js"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not AXE.is_file(), reason="axe-core is not installed: npm ci in studio"),
]
LIGHT = torch.full((64, 128, 3), 0.6)
Scheme = Literal["light", "dark"]
# run in the page's own world, past its policy of content, by the debugger
_FAULTS = """async () => (await axe.run(document, { resultTypes: ["violations"] })).violations
    .flatMap((rule) => rule.nodes.map((node) => `${rule.id} (${rule.impact}): ${node.html}`))"""


def faults(page: "Page") -> list[str]:
    """A line for each element that breaks a rule, best practice among them."""
    if not page.evaluate("() => 'axe' in window"):
        page.evaluate(AXE.read_text(encoding="utf-8"))
    return page.evaluate(_FAULTS)


def test_a_fault_would_be_found(new_page: "Callable[..., Page]") -> None:
    page = new_page()
    page.evaluate("() => document.querySelector('main').append(document.createElement('button'))")
    assert [fault for fault in faults(page) if fault.startswith("button-name (critical)")]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_the_studio_has_none(show: "Callable[..., Page]", scheme: Scheme, width: int) -> None:
    page = show(
        LIGHT,
        color_scheme=scheme,
        reduced_motion="reduce",
        viewport={"width": width, "height": 844},
    )
    found = {}
    for tab in ("Photo", "Objects", "Portrait", "Map", "Result"):
        shown = page.get_by_role("tab", name=tab)
        if shown.is_visible():  # the portrait is beside the others on a wide screen
            shown.click()
            found[tab] = faults(page)
    for name in ("sky", "codes", "voxel", "partitions"):
        page.evaluate("name => { location.hash = `#/${name}`; }", name)
        page.locator(f"nav a[href='#/{name}'][aria-current=page]").wait_for()
        expect(page.locator("h1")).to_be_visible()
        found[name] = faults(page)
    assert {where: lines for where, lines in found.items() if lines} == {}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_its_first_page_has_none(new_page: "Callable[..., Page]", scheme: Scheme) -> None:
    page = new_page(color_scheme=scheme, reduced_motion="reduce")
    page.get_by_role("region", name="Try one of these").wait_for()
    assert faults(page) == []
