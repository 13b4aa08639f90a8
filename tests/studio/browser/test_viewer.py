"""The page of ``skylight export viewer`` as somebody opens it who has nothing but the file."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.cli import main
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import pixel_from_direction
from tests.estimated import estimated, rewrite
from tests.studio.browser.composite_page import choose, placement
from tests.studio.browser.conftest import NO_WEBGL
from tests.studio.browser.pictures import FOR_DOCUMENTATION, codes, finished, picture, pixels
from tests.studio.browser.test_browser_access import CONTRASTS, NAMELESS, OVERFLOW
from tests.studio.browser.test_browser_axe import AXE, faults
from tests.studio.browser.test_browser_light import directions_as_colours, exposure
from tests.studio.browser.waiting import PATIENCE_MS, expect, gathered, painted

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SIZE = 512  # of the photograph

# what the page asks for or tries to run against its policy
_WATCH = """() => {
    window.refused = [];
    addEventListener("securitypolicyviolation", (event) => refused.push(event.effectiveDirective));
}"""


@pytest.fixture(scope="module")
def made(request: pytest.FixtureRequest) -> tuple[Path, Path]:
    """A photograph and the folder of its estimate."""
    if FOR_DOCUMENTATION:
        folders: pytest.TempPathFactory = request.getfixturevalue("tmp_path_factory")
        return estimated(folders.mktemp("estimated"), "autoencoder")
    return request.getfixturevalue("estimated_portrait")


@pytest.fixture
def estimate(made: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(made[1], tmp_path / "light"))


class Opener:
    """Opens pages from their files, without network, and keeps what they ask for and say."""

    def __init__(self, chromium: "Browser", folder: Path) -> None:
        self.chromium, self.folder = chromium, folder
        self.pages: list[Page] = []
        self.asked: list[str] = []
        self.said: list[str] = []

    def __call__(self, estimate: Path, *options: object, **context: Any) -> "Page":
        """Exports an estimate, and opens it."""
        out = self.folder / f"page {len(self.pages)}.html"
        export = ["export", "viewer", str(estimate), "--out", str(out), *map(str, options)]
        assert main(export) == 0
        return self.show(out, **context)

    def show(self, path: Path, **context: Any) -> "Page":
        options = {"viewport": {"width": 1280, "height": 900}, "offline": True, **context}
        page = self.chromium.new_context(**options).new_page()
        self.pages.append(page)
        page.set_default_timeout(PATIENCE_MS)
        page.on("request", lambda request: self.asked.append(request.url))
        page.on("pageerror", lambda error: self.said.append(str(error)))
        page.on("console", lambda line: self.said.append(line.text))
        page.add_init_script(f"({_WATCH})()")
        page.goto(path.as_uri())
        gathered(page, 1 / 64)
        painted(page)
        return page


@pytest.fixture
def opened(chromium: "Browser", tmp_path: Path) -> Iterator[Opener]:
    """At the end: pages asked for nothing but themselves, and neither complained nor failed."""
    opener = Opener(chromium, tmp_path)
    yield opener
    for page in opener.pages:
        assert page.evaluate("refused") == []
        page.context.close()
    # Chromium's own words where it has no graphics card
    assert [line for line in opener.said if "GL Driver Message" not in line] == []
    others = [url for url in opener.asked if not url.startswith(("data:", "blob:"))]
    assert all(url.startswith(tmp_path.as_uri()) and url.endswith(".html") for url in others)


def lit(estimate: Path, radiance: torch.Tensor) -> Path:
    write_environment_map(estimate / "probe.exr", EnvironmentMap(radiance=radiance))
    return estimate


class Placed:
    """The object as the page says where it is, and where the page's camera sees it."""

    def __init__(self, page: "Page") -> None:
        told = placement(page)
        self.foot, self.size = np.array(told["foot"]), float(told["size"])
        self.focal = page.evaluate(
            "JSON.parse(document.getElementById('estimate').textContent).result.camera.focal_px"
        )

    def seen(self, *point: float) -> tuple[int, int]:
        """Row and column of a point from the foot, in sizes of the object."""
        x, y, z = self.foot + self.size * np.array(point)
        row, column = SIZE / 2 + self.focal * y / z, SIZE / 2 - self.focal * x / z
        return round(row - 0.5), round(column - 0.5)


def photo_pixels(made: tuple[Path, Path]) -> np.ndarray:
    with Image.open(made[0]) as photo:
        return np.asarray(photo).astype(int)


def test_the_page_opens_from_its_file(estimate: Path, opened: Opener, pictures: Path) -> None:
    page = opened(estimate)
    expect(page.get_by_role("heading", level=1)).to_have_text("The light of portrait.jpg")
    assert page.title() == "The light of portrait.jpg"
    verdict = json.loads((estimate / "estimate.json").read_text())["verdict"]
    expect(page.locator(".verdict")).to_contain_text(verdict["light"][1:])
    expect(page.get_by_label("Object", exact=True)).to_have_value("balls")
    if FOR_DOCUMENTATION:
        gathered(page, 1)
        page.set_viewport_size({"width": 1280, "height": 1200})
        picture(page, pictures / "viewer.png")


@pytest.mark.slow
def test_the_object_moves(estimate: Path, made: tuple[Path, Path], opened: Opener) -> None:
    page = opened(estimate)
    choose(page, "Object", "box")
    choose(page, "Surface", "matte")
    photo, before = photo_pixels(made), finished(page, 1 / 64)[..., :3]
    box = Placed(page)
    row, column = box.seen(0, 0.5, 0.5)
    assert column < SIZE / 4  # on the side of the face with more room
    assert np.abs(before[:, SIZE // 2 :] - photo[:, SIZE // 2 :]).mean() < 4  # JPEG, twice
    here = np.s_[row - 8 : row + 8, column - 8 : column + 8]
    assert np.ptp(before[here], axis=(0, 1)).max() < 60
    assert np.abs(before[here] - photo[here]).mean() > 20

    canvas = page.locator("canvas.composite")
    canvas.scroll_into_view_if_needed()
    bounds = canvas.bounding_box()
    assert bounds is not None
    scale = bounds["width"] / SIZE
    x, y = bounds["x"] + column * scale, bounds["y"] + row * scale
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 256 * scale, y, steps=4)
    page.mouse.up()
    after = finished(page, 1 / 64)[..., :3]
    there = np.s_[row - 8 : row + 8, column + 248 : column + 264]
    assert np.abs(after[here] - photo[here]).mean() < 8
    assert np.abs(after[there] - before[there]).mean() > 20
    moved = Placed(page)
    assert moved.size == box.size
    assert moved.foot - box.foot == pytest.approx([-256 * box.foot[2] / box.focal, 0, 0], abs=0.01)


@pytest.mark.slow
def test_the_head_hides_what_is_behind_it(
    estimate: Path, made: tuple[Path, Path], opened: Opener
) -> None:
    page = opened(estimate)
    choose(page, "Object", "box")
    choose(page, "Surface", "matte")
    placed, photo = Placed(page), photo_pixels(made)
    told = json.loads((estimate / "estimate.json").read_text())["faces"][0]
    inside = placed.seen(*((np.array(told["eyes"]) - placed.foot) / placed.size))
    canvas = page.locator("canvas.composite")
    canvas.scroll_into_view_if_needed()
    bounds = canvas.bounding_box()
    assert bounds is not None
    scale = bounds["width"] / SIZE
    for move, (row, column) in ("down", placed.seen(0, 0.5, 0)), ("up", inside):
        page.mouse.move(bounds["x"] + column * scale, bounds["y"] + row * scale)
        getattr(page.mouse, move)()
    seen = finished(page, 1 / 64)[..., :3]
    assert Placed(page).seen(0, 0.5, 0) == pytest.approx(inside, abs=3)
    row, column = inside
    head = np.s_[row - 8 : row + 8, column - 8 : column + 8]
    assert np.abs(seen[head] - photo[head]).mean() < 8
    row, column = Placed(page).seen(0, -0.2 / placed.size, 0)  # its rod, below the chin
    assert np.abs(seen[row, column] - photo[row, column]).max() > 20


@pytest.mark.slow
def test_the_object_has_the_photographs_white_balance(estimate: Path, opened: Opener) -> None:
    told = json.loads((estimate / "estimate.json").read_text())["faces"]
    gains = [1.25, 1.0, 0.8]
    rewrite(estimate, faces=[{**told[0], "white_balance": gains}])
    page = opened(lit(estimate, torch.full((64, 128, 3), 0.5)))
    choose(page, "Object", "ball")
    choose(page, "Surface", "mirror")
    row, column = Placed(page).seen(0, 0.5, 0.5)
    seen = finished(page, 1 / 64)[row, column, :3]
    want = codes(0.5 * np.array(gains))
    assert np.abs(seen / seen[1] - want / want[1]).max() < 0.03, (seen, want)


@pytest.mark.slow
def test_each_axis_is_on_its_side(estimate: Path, opened: Opener) -> None:
    page = opened(lit(estimate, directions_as_colours()))
    scale = exposure(page)
    panorama = pixels(page, ".panorama canvas")
    height, width = panorama.shape[:2]
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        towards = torch.as_tensor(direction + 0.02)  # off the seam and the poles
        row, column = pixel_from_direction(towards / towards.norm(), height, width)
        seen = panorama[round(float(row)), round(float(column)), :3]
        want = codes(scale * (np.asarray(towards / towards.norm()) + 1) / 2)
        assert np.abs(seen - want).max() < 8, direction
    choose(page, "Object", "ball")
    choose(page, "Surface", "mirror")
    in_photo, ball = finished(page, 1 / 64), Placed(page)
    left, right = ball.seen(-0.3, 0.5, 0.4), ball.seen(0.3, 0.5, 0.4)
    low, high = ball.seen(0, 0.2, 0.4), ball.seen(0, 0.8, 0.4)
    assert in_photo[right][0] > in_photo[left][0] + 60
    assert in_photo[high][1] > in_photo[low][1] + 60


@pytest.mark.slow
@pytest.mark.parametrize(
    ("doubt", "class_", "told"),
    [
        (
            "hardly a face",
            "verdict care",
            "Soft light from above. Verdict: Unreliable: hardly a face.",
        ),
        ("", "verdict", "Soft light from above. Direction: Sure: within 9°. Brightness: Rough"),
    ],
)
def test_what_may_not_be_trusted_says_so_first(
    estimate: Path, opened: Opener, doubt: str, class_: str, told: str
) -> None:
    sure = {"word": "sure", "within": 9.0, "reason": "within 9°"}
    rough = {"word": "rough", "within": 1.5, "reason": "within a factor of 1.5"}
    rewrite(
        estimate,
        posterior={"is_seen": True},
        verdict={
            "light": "soft light from above",
            "direction": sure,
            "brightness": rough,
            "colour": rough,
            "doubt": doubt,
        },
    )
    shown = opened(estimate).locator(".verdict")
    expect(shown).to_have_class(class_)
    expect(shown).to_contain_text(told)


@pytest.mark.slow
def test_text_is_shown_as_text(estimate: Path, made: tuple[Path, Path], opened: Opener) -> None:
    bad = "</script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>"
    name = "<img src=x onerror='window.hacked = 1'>.jpg"
    shutil.copy(made[0], estimate / name)
    rewrite(estimate, advice=[bad], verdict={"light": bad})
    page = opened(estimate, "--photo", estimate / name)
    expect(page.get_by_role("heading", level=1)).to_have_text(f"The light of {name}")
    expect(page.locator(".verdict")).to_contain_text(bad)
    expect(page.locator(".care", has_text=bad).last).to_be_visible()
    assert page.evaluate("window.hacked") is None


@pytest.mark.slow
def test_a_script_that_is_added_does_not_run(
    estimate: Path, opened: Opener, tmp_path: Path
) -> None:
    opened(estimate)
    spoilt = tmp_path / "spoilt.html"
    text = (tmp_path / "page 0.html").read_text(encoding="utf-8")
    added = "<script>window.hacked = 1</script>"
    spoilt.write_text(text.replace("</body>", f"{added}</body>"), encoding="utf-8")
    page = opened.show(spoilt)
    page.evaluate("fetch('https://example.org/').catch(() => {})")
    page.wait_for_function("() => refused.length === 2")
    assert page.evaluate("[window.hacked ?? 0, ...refused]") == [
        0,
        "script-src-elem",
        "connect-src",
    ]
    page.evaluate("refused.length = 0")
    opened.said.clear()


@pytest.mark.slow
def test_a_model_with_its_texture_stands_there_first(estimate: Path, opened: Opener) -> None:
    trimesh = pytest.importorskip("trimesh")
    green = Image.new("RGB", (8, 8), (0, 255, 0))
    box = trimesh.creation.box((1, 1, 1))
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=green, metallicFactor=0.0, roughnessFactor=1.0
    )
    box.visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), material=material)
    path = estimate / "a box.glb"
    box.export(path)
    page = opened(lit(estimate, torch.full((64, 128, 3), 0.6)), "--object", path)
    option = page.locator("option[value=file]", has_text="a box.glb")
    option.wait_for(state="attached")
    gathered(page, 1 / 64)
    red, seen, blue = finished(page, 1 / 64)[Placed(page).seen(0, 0.5, 0.5)][:3]
    assert seen > 120 > 80 > max(red, blue)


@pytest.mark.slow
def test_without_webgl_photograph_and_light_are_there(
    estimate: Path, opened: Opener, tmp_path: Path
) -> None:
    opened(estimate)
    page = opened.chromium.new_context(offline=True).new_page()
    page.add_init_script(NO_WEBGL)
    page.goto((tmp_path / "page 0.html").as_uri())
    expect(page.get_by_text("no object can be drawn into the photo")).to_be_visible()
    expect(page.get_by_alt_text("The photograph")).to_be_visible()
    expect(page.locator(".panorama canvas")).to_be_visible()
    page.context.close()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_is_for_everybody(
    estimate: Path, opened: Opener, scheme: Literal["light", "dark"]
) -> None:
    rewrite(estimate, verdict={"doubt": "hardly a face"})
    narrow = {"width": 390, "height": 844}
    page = opened(estimate, viewport=narrow, has_touch=True, color_scheme=scheme)
    assert page.evaluate(OVERFLOW) == 0
    assert page.evaluate(NAMELESS) == []
    contrasts = page.evaluate(CONTRASTS)
    assert len(contrasts) > 25
    assert [(ratio, text) for ratio, text in contrasts if ratio < 4.5] == []


@pytest.mark.skipif(not AXE.is_file(), reason="axe-core is not installed: npm ci in studio")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_fault(
    opened: Opener, estimate: Path, scheme: Literal["light", "dark"]
) -> None:
    assert faults(opened(estimate, color_scheme=scheme)) == []
