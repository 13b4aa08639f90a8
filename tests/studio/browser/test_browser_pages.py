"""The sky, codes and probes pages in a real browser: what they compute, show, and hand out."""

import io
import json
import statistics
import struct
import zipfile
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from jaxtyping import Float
from PIL import Image

from skylight.imaging._colour import linear_to_srgb
from skylight.io._files import write_environment_map
from skylight.io._light import read_linear
from skylight.models._bundle import load_bundle
from skylight.models._ground import LambertianGround
from skylight.relight._decoder import read_latent
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from skylight.studio.tasks._sky import NAMES
from tests.studio.browser.test_browser_access import CONTRASTS, NAMELESS, OVERFLOW
from tests.studio.browser.waiting import PATIENCE_MS, expect, painted

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

MakePage = Callable[..., "Page"]
WHITE = 1.5  # the radiance that the sky page shows as white at exposure 0
PAGES = ("sky", "codes", "voxel", "partitions")

# counts what workers were asked and have not answered
UNDER_WAY = """(() => {
    window.underWay = 0;
    const post = Worker.prototype.postMessage;
    Worker.prototype.postMessage = function (...message) {
        window.underWay++;
        this.addEventListener("message", () => window.underWay--, { once: true });
        post.apply(this, message);
    };
})()"""
# until the sky's picture has come to rest: its finest drawing, of the newest wish
SETTLED = """async () => {
    const frame = () => new Promise(requestAnimationFrame);
    const scene = document.querySelector("canvas[data-updates]");
    while (window.underWay) await frame();
    await frame(); // the last sky is painted, less fine
    while (scene.width <= scene.clientWidth) await frame();
    await frame();
    return true;
}"""

# drags a slider from end to end as events come from a hand, and notes when skies were painted
DRAG = """async ([label, steps]) => {
    const named = [...document.querySelectorAll("label")];
    const id = named.find((one) => one.textContent.startsWith(label)).htmlFor;
    const slider = document.getElementById(id);
    const scene = document.querySelector("canvas[data-updates]");
    const times = [];
    const watch = new MutationObserver(() => times.push(performance.now()));
    watch.observe(scene, { attributes: true, attributeFilter: ["data-updates"] });
    const [low, high] = [Number(slider.min), Number(slider.max)];
    for (let step = 0; step < steps; step++) {
        slider.value = low + ((high - low) * step) / (steps - 1);
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        await new Promise((go) => setTimeout(() => requestAnimationFrame(go), 25));
    }
    watch.disconnect();
    return times;
}"""


@pytest.fixture(scope="module")
def open_sky(chromium: "Browser", studio_address: str) -> "Iterator[Page]":
    """The sky page, its decoder and its object ready."""
    page = chromium.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(PATIENCE_MS)
    page.add_init_script(UNDER_WAY)
    page.goto(f"{studio_address}/#/sky")
    page.wait_for_selector("canvas[data-updates]")
    yield page
    page.close()


@pytest.fixture
def sky(open_sky: "Page") -> "Page":
    """The same with its sliders where they are at first."""
    open_sky.get_by_role("button", name="Mean sky").click()
    for label, value in (
        ("Side of the sun", 115),
        ("Brightness of the ground", 0.2),
        ("Exposure", 0),
    ):
        slide(open_sky, label, value)
    return open_sky


def slide(page: "Page", label: str, value: float) -> None:
    page.get_by_label(label).evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }",
        value,
    )


def component(page: "Page", number: int, value: float) -> None:
    slide(page, NAMES[number - 1], value)


def fetched(page: "Page", link: "Locator", folder: Path) -> Path:
    """What a click on it downloads."""
    with page.expect_download() as waiting:
        link.click()
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path


def settled(page: "Page") -> None:
    page.wait_for_function(SETTLED)


def shown(page: "Page", selector: str) -> Float[np.ndarray, "h w 3"]:
    """An element's picture, 0 to 1."""
    picture = page.locator(selector).screenshot()
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), np.float32) / 255


@pytest.fixture
def sunny(studio_sky: dict[str, Any]) -> list[float]:
    """Components of a sky whose sun stands about half high and gives more light than the sky."""
    axes, sigmas = torch.tensor(studio_sky["components"]), torch.tensor(studio_sky["sigmas"])
    tries = torch.randn(500, 8, generator=torch.Generator().manual_seed(0)).clamp(-2, 2)
    tries = (20 * tries).round() / 20
    sun = (torch.tensor(studio_sky["mean"]) + (tries * sigmas) @ axes)[:, -5:]
    zenith_deg = 90 * torch.sigmoid(1.5 * sun[:, 0])
    energy = (2 * sun[:, 1:4] - 1).exp().mean(1)
    unlike = (energy / 6).log().abs()
    return tries[torch.where((zenith_deg - 45).abs() < 8, unlike, torch.inf).argmin()].tolist()


@pytest.fixture(scope="module")
def studio_sky(studio_address: str) -> dict[str, Any]:
    """What the page is told of the latents."""
    import httpx

    return httpx.get(f"{studio_address}/api/sky.json", timeout=60).json()


@pytest.fixture
def light_map(tmp_path: Path) -> Path:
    """Two lobes of light over a grey surrounding."""
    grid = DirectionGrid.latlong(32)
    radiance = torch.full((32 * 64, 3), 0.2, dtype=torch.float64)
    for azimuth, zenith, width, colour in ((60, 45, 8, (8, 6, 4)), (-100, 70, 20, (0.5, 1, 2))):
        towards = direction_from_angles(*torch.tensor([azimuth, zenith]).deg2rad().double())
        lobe = ((grid.directions @ towards - 1) / np.deg2rad(width) ** 2).exp()
        radiance += lobe[:, None] * torch.tensor(colour)
    path = tmp_path / "two lobes.hdr"
    write_environment_map(path, EnvironmentMap(radiance=radiance.reshape(32, 64, 3).float()))
    return path


# The sky page


def test_the_decoded_sky_is_torchs(sky: "Page", studio_sky: dict[str, Any], tmp_path: Path) -> None:
    values = [1.25, -0.6, 0.5, 2.0, 0.0, -1.0, 0.75, 0.3]
    for number, value in enumerate(values, 1):
        component(sky, number, value)
    slide(sky, "Side of the sun", -97)
    slide(sky, "Brightness of the ground", 0.35)
    settled(sky)
    latent = fetched(sky, sky.get_by_role("button", name="Recipe"), tmp_path)
    map_ = fetched(sky, sky.get_by_role("button", name="Map"), tmp_path)
    read = read_latent(latent)  # as `skylight relight --latent` does
    expected = np.array(studio_sky["mean"])
    for value, sigma, axis in zip(
        values, studio_sky["sigmas"], studio_sky["components"], strict=True
    ):
        expected = expected + value * sigma * np.array(axis)
    np.testing.assert_allclose(read.z, expected, atol=1e-4)
    assert read.azimuth_rad == pytest.approx(np.deg2rad(-97))
    assert read.ground_albedo == pytest.approx((0.35,) * 3, abs=1e-6)
    params = torch.tensor([[*read.z.tolist(), read.azimuth_rad]])
    with torch.no_grad():
        upper = load_bundle().light()(params)
    full = LambertianGround().append(upper, torch.tensor([read.ground_albedo]))
    truth = full.reshape(64, 128, 3).numpy()
    written = read_linear(map_)
    # RGBE's step is 1/256 of the largest channel, half of it rounding
    allowed = 0.5 / 128 * truth.max(-1, keepdims=True) + 1e-3
    assert (np.abs(written - truth) <= allowed).all()
    # and a strong sun, whose energies are latents -4 to -2, is where the slider says: left
    sunny = np.array(studio_sky["components"])[:, -4:-1].sum(1) > 0
    for number, more in enumerate(sunny.tolist(), 1):
        component(sky, number, 1.5 if more else -1.5)
    settled(sky)
    written = read_linear(fetched(sky, sky.get_by_role("button", name="Map"), tmp_path))
    _, column = np.unravel_index(written[:32].sum(-1).argmax(), (32, 128))
    assert column == pytest.approx((-97 / 360 + 0.5) * 128 - 0.5, abs=1)


def test_a_dragged_slider_repaints_sky_and_object_without_the_server(
    sky: "Page", record_property: Callable[[str, object], None]
) -> None:
    settled(sky)
    asked: list[str] = []
    sky.on("request", lambda request: asked.append(request.url))
    for label in (NAMES[0], "Side of the sun"):
        sky.evaluate(DRAG, [label, 20])  # until the picture has found its pace
        times = sky.evaluate(DRAG, [label, 120])
        rate = 1000 / statistics.median(np.diff(times))
        record_property(f"updates_per_second ({label})", float(rate))
        print(f"{label}: {rate:.1f} updates a second, {len(times)} updates of 120 steps")
        assert len(times) >= 30  # steps wait for frames, so also on a slow or busy machine
    assert asked == []


def test_ground_in_the_picture_is_as_bright_as_the_decoded_light_makes_it(
    sky: "Page", sunny: list[float], tmp_path: Path
) -> None:
    for number, value in enumerate(sunny, 1):
        component(sky, number, value)
    slide(sky, "Side of the sun", 180)  # behind the camera, so that shadows fall away from it
    slide(sky, "Exposure", -2)
    settled(sky)
    ground = read_linear(fetched(sky, sky.get_by_role("button", name="Map"), tmp_path))[-1, 0]
    expected = linear_to_srgb(torch.tensor(ground) / WHITE / 4).numpy()
    assert 0.1 < expected.min() < expected.max() < 0.95  # neither black nor cut
    picture = shown(sky, ".sky-scene")
    height, width = picture.shape[:2]
    # before the objects, where it is lit by the split light, its sky a little hidden by them
    near = picture[int(0.92 * height) : int(0.97 * height), int(0.8 * width) : int(0.95 * width)]
    np.testing.assert_allclose(near.mean((0, 1)), expected, rtol=0.04)


@pytest.mark.parametrize(("azimuth", "dark"), [(-90, True), (90, False)])
def test_the_shadow_falls_away_from_the_sun(
    sky: "Page", sunny: list[float], azimuth: float, dark: bool
) -> None:
    for number, value in enumerate(sunny, 1):
        component(sky, number, value)
    slide(sky, "Side of the sun", azimuth)
    slide(sky, "Exposure", -1)
    settled(sky)
    picture = shown(sky, ".sky-scene").mean(-1)
    height, width = picture.shape
    # the ground right of the mirror ball's foot, and before all objects
    aside = picture[int(0.80 * height) : int(0.84 * height), int(0.79 * width) : int(0.84 * width)]
    before = picture[int(0.92 * height) : int(0.97 * height), int(0.8 * width) : int(0.95 * width)]
    assert (aside.mean() < 0.6 * before.mean()) if dark else (aside.mean() > 0.9 * before.mean())


def test_random_and_mean_sky(sky: "Page") -> None:
    sliders = sky.get_by_role("group", name="The sky").get_by_role("slider")

    def values() -> list[float]:
        return [float(one.input_value()) for one in sliders.all()]

    sky.get_by_role("button", name="Random sky").click()
    assert len(values()) == 8
    assert len(set(values())) > 4
    sky.get_by_role("button", name="Mean sky").click()
    for slider in sliders.all():
        expect(slider).to_have_value("0")


def test_the_sky_pages_picture(sky: "Page", sunny: list[float], pictures: Path) -> None:
    for number, value in enumerate(sunny, 1):
        component(sky, number, value)
    settled(sky)
    sky.screenshot(path=pictures / "sky.png", full_page=True)


# Sparse codes


def test_a_map_becomes_a_code(
    new_page: MakePage, light_map: Path, tmp_path: Path, pictures: Path
) -> None:
    page = new_page("/#/codes")
    expect(page.get_by_role("button", name="Take it apart")).to_be_disabled()
    page.set_input_files("input[type=file]", light_map)
    page.get_by_text("two lobes.hdr is chosen").wait_for()
    page.get_by_label("Shape of the pieces").select_option("iso")
    slide(page, "Pieces at most", 12)
    page.get_by_role("button", name="Take it apart").click()
    page.get_by_role("heading", name="Files").wait_for()
    page.get_by_text("The same as a table").click()
    table = page.get_by_role("region", name="The same as a table").locator("tbody tr")
    expect(table).to_have_count(7)
    errors = [row.inner_text().split("\t") for row in table.all()]
    shares = [float(error.removesuffix("%")) for _, error in errors]
    assert [int(count) for count, _ in errors] == [1, 2, 3, 4, 6, 8, 12]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] < 10
    expect(page.locator("svg title")).to_contain_text("with 12")
    page.get_by_text("pieces as a table").click()
    rows = page.get_by_role("region", name="pieces").locator("tbody tr")
    expect(rows).to_have_count(12)
    strongest = rows.first.inner_text().split("\t")
    assert float(strongest[1].rstrip("°")) == pytest.approx(60, abs=4)
    assert float(strongest[2].rstrip("°")) == pytest.approx(45, abs=4)
    panorama = ".panorama >> nth=0"
    painted(page)
    with_rings = shown(page, panorama)
    slide(page, "Strongest pieces to show", 0)
    painted(page)
    without = shown(page, panorama)
    ringed = np.argwhere(np.abs(with_rings - without).max(-1) > 0.2)
    assert len(ringed) > 50
    code = fetched(page, page.get_by_role("link", name="code.json"), tmp_path)
    assert len(json.loads(code.read_text())["activations"]) == 12
    slide(page, "Strongest pieces to show", 12)
    painted(page)
    page.screenshot(path=pictures / "codes.png", full_page=True)


def test_what_is_no_map_is_refused_in_one_line(new_page: MakePage, tmp_path: Path) -> None:
    wrong = tmp_path / "notes.hdr"
    wrong.write_text("not a picture")
    page = new_page("/#/codes")
    page.set_input_files("input[type=file]", wrong)
    line = page.get_by_role("alert").filter(has_text="notes.hdr")
    line.wait_for()
    assert len(line.inner_text().splitlines()) == 1
    expect(page.get_by_role("button", name="Take it apart")).to_be_disabled()


# Probes


def test_a_voxel_probe_is_made_and_lit(
    new_page: MakePage, light_map: Path, tmp_path: Path, pictures: Path
) -> None:
    page = new_page("/#/voxel")
    page.set_input_files("input[type=file]", light_map)
    page.get_by_text("two lobes.hdr is chosen").wait_for()
    page.get_by_role("button", name="Make the probe").click()
    page.get_by_role("heading", name="Files").wait_for()
    check = page.locator("section", has=page.get_by_role("heading", name="Print check"))
    expect(check).to_contain_text("Sound")
    expect(page.get_by_text("shows 30 of the 192 kinds")).to_be_visible()
    page.get_by_text("kinds of faces as a table").click()
    rows = page.get_by_role("region", name="kinds of faces").locator("tbody tr")
    expect(rows).to_have_count(192)
    turns_by_keyboard(page)
    stl = fetched(page, page.get_by_role("link", name="parts.stl"), tmp_path).read_bytes()
    assert len(stl) == 84 + 50 * struct.unpack_from("<I", stl, 80)[0]
    page.screenshot(path=pictures / "voxel.png", full_page=True)


def test_sizes_that_cannot_be_printed_are_refused(new_page: MakePage) -> None:
    page = new_page("/#/voxel")
    page.get_by_label("Walls").fill("6")
    page.get_by_role("button", name="Make the probe").click()
    line = page.get_by_role("alert").filter(has_text="leave no room for a joint")
    line.wait_for()
    page.get_by_label("Walls").fill("")
    page.get_by_role("button", name="Make the probe").click()
    page.get_by_role("alert").filter(has_text="wall_mm").wait_for()


def test_a_partitions_probe_is_made_and_lit(
    new_page: MakePage, light_map: Path, tmp_path: Path, pictures: Path
) -> None:
    page = new_page("/#/partitions")
    page.set_input_files("input[type=file]", light_map)
    page.get_by_text("two lobes.hdr is chosen").wait_for()
    page.get_by_role("button", name="Make the probe").click()
    page.get_by_role("heading", name="Files").wait_for()
    page.get_by_text("cells as a table").click()
    rows = page.get_by_role("region", name="cells").locator("tbody tr")
    rows.first.wait_for()
    solid_angles = [float(row.split("\t")[1]) for row in rows.all_inner_texts()]
    assert sum(solid_angles) == pytest.approx(4 * np.pi, abs=0.001 * len(solid_angles))
    painted(page)
    looks = [shown(page, ".turntable")]
    for view in ("cells", "parts", "kernel"):
        page.get_by_label("Show").select_option(view)
        painted(page)
        looks.append(shown(page, ".turntable"))
    for one, other in pairwise(looks):
        assert np.abs(one - other).max() > 0.1
    turns_by_keyboard(page)
    archive = fetched(page, page.get_by_role("link", name="all files"), tmp_path)
    with zipfile.ZipFile(archive) as files:
        assert files.testzip() is None
        assert {"parts.3mf", "preview.glb", "lightmap.png"} <= set(files.namelist())
    page.get_by_label("Show").select_option("cells")
    page.screenshot(path=pictures / "partitions.png", full_page=True)


def turns_by_keyboard(page: "Page") -> None:
    """Whether the arrow keys show the object from another side."""
    painted(page)
    before = shown(page, ".turntable")
    page.locator(".turntable").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    painted(page)
    assert np.abs(shown(page, ".turntable") - before).max() > 0.1


# All of them

# whether the server's choices have arrived
READY = """() => {
    const choices = [...document.querySelectorAll("select")];
    const filled = choices.length && choices.every((one) => one.length);
    return document.querySelector("fieldset") || filled;
}"""
CONTROLS = """() => {
    const all = document.querySelectorAll("main :is(button, select, input, a[href], summary)");
    return [...all].filter((one) => one.checkVisibility() && !one.disabled).length;
}"""
FOCUSED = """() => {
    const one = document.activeElement;
    return one.closest("main") ? one.outerHTML : "";
}"""


@pytest.mark.parametrize("name", PAGES)
def test_pages_fit_a_phone_can_be_read_and_reached_by_keyboard(
    new_page: MakePage, name: str
) -> None:
    page = new_page(f"/#/{name}", viewport={"width": 360, "height": 740})
    page.wait_for_function(READY)
    assert page.evaluate(OVERFLOW) == 0
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_function(f"matchMedia('(prefers-color-scheme: {scheme})').matches")
        assert page.evaluate(NAMELESS) == []
        assert [text for ratio, text in page.evaluate(CONTRASTS) if ratio < 4.5] == []
    wanted = page.evaluate(CONTROLS)
    reached: set[str] = set()
    for _ in range(wanted + 20):
        page.keyboard.press("Tab")
        reached.add(page.evaluate(FOCUSED))
    assert len(reached - {""}) >= wanted


def test_a_sky_page_without_its_decoder_says_so(new_page: MakePage) -> None:
    page = new_page("/")
    page.route("**/api/sky.onnx", lambda route: route.abort())
    page.evaluate("location.hash = '#/sky'")
    page.get_by_role("alert").filter(has_text="does not answer").wait_for()
