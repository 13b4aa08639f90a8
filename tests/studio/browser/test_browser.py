"""The whole path of a photo in a real browser, and what its owner sees when something fails."""

import base64
import io
import json
import os
import re
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np
import pytest
from PIL import Image
from skimage.data import astronaut, camera, coffee

import skylight

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page, Route

# the documentation's pictures are worth waiting for: of the best light, with all of it in
FOR_DOCUMENTATION = "SKYLIGHT_STUDIO_PICTURES" in os.environ
MakePage = Callable[..., "Page"]
LINE = "[role=alert] .alert"

# a file as a user lets go of it over the page, with the bytes in it
_DROP = """([place, url, name]) => {
    const bytes = Uint8Array.from(atob(url), (letter) => letter.charCodeAt(0));
    const transfer = new DataTransfer();
    transfer.items.add(new File([bytes], name));
    const target = document.querySelector(place);
    for (const kind of ["dragenter", "dragover", "drop"])
        target.dispatchEvent(
            new DragEvent(kind, { dataTransfer: transfer, bubbles: true, cancelable: true }));
}"""
_PASTE = """([url, name]) => {
    const clipboardData = new DataTransfer();
    const bytes = Uint8Array.from(atob(url), (letter) => letter.charCodeAt(0));
    clipboardData.items.add(new File([bytes], name));
    document.dispatchEvent(new ClipboardEvent("paste", { clipboardData }));
}"""
_OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


@pytest.fixture(scope="module")
def portrait(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("photos") / "portrait.jpg"
    Image.fromarray(astronaut()).save(path, quality=92)
    return path


def choose_photo(page: "Page", path: Path) -> None:
    page.locator("input[type=file][accept^='image']").set_input_files(path)


def drop(page: "Page", path: Path, place: str = ".drop") -> None:
    page.evaluate(_DROP, [place, base64.b64encode(path.read_bytes()).decode(), path.name])


def estimated(page: "Page", light: str) -> dict[str, Any]:
    """Finds the light with that model; the job as the server then describes it."""
    page.locator(f"input[value={light}]").check()
    count = page.locator(".result").count()
    with page.expect_response("**/api/jobs") as started:
        page.locator("button.primary", has_text=re.compile("Find .* light")).click()
    page.locator(".result").nth(count).wait_for(timeout=180_000)
    job = started.value.json()["job"]
    return asked(page, f"/api/jobs/{job}")


def paste(page: "Page", path: Path) -> None:
    page.evaluate(_PASTE, [base64.b64encode(path.read_bytes()).decode(), path.name])


def asked(page: "Page", path: str) -> dict[str, Any]:
    """What the server answers the page."""
    return page.evaluate("path => fetch(path).then((answer) => answer.json())", path)


def picture(shown: "Page | Locator", path: Path) -> None:
    """A screenshot as the documentation has it: 900 pixels wide at most, of 256 colours."""
    full = Image.open(io.BytesIO(shown.screenshot())).convert("RGB")
    full.thumbnail((900, 2000), Image.Resampling.LANCZOS)
    palette = full.quantize(256)
    full.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(path, optimize=True)


def light_in(page: "Page") -> None:
    share = 1 if FOR_DOCUMENTATION else 1 / 8
    page.wait_for_function(
        "share => document.querySelector('.composite').dataset.share >= share",
        arg=share,
        timeout=180_000,
    )


def test_from_a_dropped_photo_to_a_downloaded_map(
    new_page: MakePage, studio_address: str, portrait: Path, tmp_path: Path, pictures: Path
) -> None:
    page = new_page(color_scheme="light", accept_downloads=True)
    page.wait_for_load_state("networkidle")  # the examples are in
    picture(page, pictures / "studio_start.png")
    drop(page, portrait)
    page.get_by_role("button", name="The face").wait_for()
    page.locator("input[value=sh9]").check()
    page.get_by_role("button", name="Find the light").click()
    page.get_by_role("progressbar").wait_for()
    page.get_by_role("status").get_by_text(
        re.compile("(Fitting|Tracing|Estimating) .*…")
    ).wait_for()
    page.get_by_role("button", name="Cancel").wait_for()
    picture(page, pictures / "studio_faces.png")
    page.locator(".result").wait_for(timeout=180_000)

    link = page.get_by_role("link", name=re.compile("^probe.exr"))
    with page.expect_download() as download:
        link.click()
    saved = tmp_path / download.value.suggested_filename
    download.value.save_as(saved)
    assert saved.name == "probe.exr"
    href = link.get_attribute("href")
    with urllib.request.urlopen(f"{studio_address}{href}") as answer:
        assert saved.read_bytes() == answer.read()
    environment = skylight.read_environment_map(saved)
    assert environment.radiance.shape == (64, 128, 3)
    assert float(environment.radiance.max()) > 0

    with page.expect_download() as download:
        page.get_by_role("link", name="all files.zip").click()
    download.value.save_as(tmp_path / "all.zip")
    with ZipFile(tmp_path / "all.zip") as packed:
        names = set(packed.namelist())
        told = json.loads(packed.read("estimate.json"))
    listed = page.locator("ul.files a").evaluate_all("links => links.map(a => a.download)")
    assert names | {"all files.zip"} == set(listed)
    zenith = page.locator("dt:text('Zenith angle') + dd").text_content() or ""
    assert zenith.startswith(f"{round(told['sun']['zenith_deg'])}°")

    # a second light beside the first, the object lit by the newer one
    second = "autoencoder" if FOR_DOCUMENTATION else "sh25"
    job = estimated(page, second)
    assert job["result"]["light"] == second
    assert page.locator(".result").count() == 2
    title = page.locator(".result h3").nth(1).text_content()
    assert page.get_by_label("Lit by").input_value() == title
    assert page.get_by_role("article", name=title, exact=True).count() == 1
    page.get_by_label("Surface", exact=True).select_option("glazed")
    light_in(page)
    if FOR_DOCUMENTATION:
        in_photo, light = (
            page.get_by_role("region", name=name) for name in ("In your photo", "The light")
        )
        picture(in_photo, pictures / "studio_photo.png")
        picture(light, pictures / "studio_lights.png")
        page.emulate_media(color_scheme="dark")
        picture(light, pictures / "studio_dark.png")

    # another page and back: the result is still there
    page.goto(f"{studio_address}/#/codes")
    page.get_by_role("heading", level=1, name="Sparse codes").wait_for()
    page.goto(f"{studio_address}/#/face")
    assert page.locator(".result").count() == 2


def test_an_example_is_taken_as_a_chosen_file_is(new_page: MakePage) -> None:
    page = new_page()
    row = page.get_by_role("region", name="Try one of these")
    row.get_by_role(
        "button", name=re.compile("behind a camera.* Fails, and says so: .*CC0")
    ).focus()
    with page.expect_response("**/api/photos?name=cameraman.png") as answered:
        page.keyboard.press("Enter")
    taken = answered.value.json()
    assert (taken["width"], taken["height"], len(taken["faces"])) == (*camera().shape, 1)
    page.get_by_role("img", name="Your photo, cameraman.png").wait_for()
    row.get_by_role("button", name=re.compile("astronaut.* Works: .*NASA")).click()
    page.get_by_role("img", name="Your photo, astronaut.png").wait_for()
    assert page.get_by_role("button", name="Find the light").is_enabled()


@pytest.mark.slow
def test_one_of_two_faces(new_page: MakePage, tmp_path: Path, pictures: Path) -> None:
    two = np.concatenate([astronaut()[:, 60:400], astronaut()[:, 60:400]], axis=1)
    Image.fromarray(two).save(tmp_path / "two.png")
    page = new_page()
    paste(page, tmp_path / "two.png")
    first = page.get_by_role("button", name="Face 1 of 2")
    second = page.get_by_role("button", name="Face 2 of 2")
    everyone = page.get_by_role("button", name="All 2 faces")
    first.wait_for()
    left, right = first.bounding_box(), second.bounding_box()
    assert left
    assert right
    assert abs(left["x"] - right["x"]) > 200
    everyone.click()
    assert first.get_attribute("aria-pressed") == "false"
    assert everyone.get_attribute("aria-pressed") == "true"
    second.click()
    assert second.get_attribute("aria-pressed") == "true"
    job = estimated(page, "sh9")
    assert [face["number"] for face in job["result"]["faces"]] == [2]
    assert page.get_by_role("article", name="Spherical harmonics").count() == 1


def test_files_that_are_no_use(new_page: MakePage, portrait: Path, tmp_path: Path) -> None:
    page = new_page()
    line = page.locator(LINE)
    (tmp_path / "notes.jpg").write_text("dear diary")
    drop(page, tmp_path / "notes.jpg")
    line.wait_for()
    assert "picture" in (line.text_content() or "").lower()

    (tmp_path / "heavy.png").write_bytes(bytes(3_100_000))
    choose_photo(page, tmp_path / "heavy.png")
    line.get_by_text("heavy.png is larger than 3 MB").wait_for()

    Image.new("L", (2000, 1500)).save(tmp_path / "wide.png")
    choose_photo(page, tmp_path / "wide.png")
    line.get_by_text("million pixels").wait_for()

    Image.fromarray(camera()).convert("1").save(tmp_path / "bits.png")
    choose_photo(page, tmp_path / "bits.png")
    line.get_by_text("one bit a pixel").wait_for()

    Image.fromarray(coffee()).save(tmp_path / "empty.png")
    choose_photo(page, tmp_path / "empty.png")
    page.get_by_role("alert").get_by_text("No face was found").wait_for()
    assert page.locator("button", has_text="Find the light").count() == 0

    choose_photo(page, portrait)  # the page is still of use
    page.get_by_role("button", name="The face").wait_for()
    assert line.count() == 0


@pytest.mark.slow
def test_a_job_that_fails_and_a_server_that_is_gone(new_page: MakePage, portrait: Path) -> None:
    page = new_page()
    choose_photo(page, portrait)
    start = page.get_by_role("button", name="Find the light")
    line = page.locator(LINE)

    def ask_for_another_face(route: "Route") -> None:
        body = json.loads(route.request.post_data or "")
        route.continue_(post_data=json.dumps({**body, "face": 7}))

    page.route("**/api/jobs", ask_for_another_face)
    start.click()
    line.get_by_text(re.compile("face", re.IGNORECASE)).wait_for(timeout=120_000)
    assert page.get_by_role("progressbar").count() == 0
    page.unroute("**/api/jobs")

    page.route("**/events", lambda route: route.abort())
    start.click()
    line.get_by_text("The studio does not answer").wait_for()
    page.unroute("**/events")

    page.context.set_offline(True)
    choose_photo(page, portrait)
    page.locator(LINE).get_by_text("The studio does not answer").first.wait_for()
    page.context.set_offline(False)
    choose_photo(page, portrait)
    page.get_by_role("button", name="Find the light").wait_for()


def test_too_many_jobs_and_a_cancelled_one(new_page: MakePage, portrait: Path) -> None:
    first, second = new_page(), new_page()
    for page in (first, second):
        choose_photo(page, portrait)
        page.get_by_role("button", name="Find the light").wait_for()
    first.get_by_role("button", name="Find the light").click()
    cancel = first.get_by_role("button", name="Cancel")
    first.get_by_role("status").get_by_text(re.compile("(Fitting|Tracing) .*…")).wait_for()
    second.get_by_role("button", name="Find the light").click()
    second.locator(LINE).get_by_text("jobs are waiting or running").wait_for()

    with first.expect_request(lambda request: request.method == "DELETE") as forgotten:
        cancel.click()
    assert not cancel.is_visible()
    assert first.locator(LINE).count() == 0  # it was the user's wish
    answer = forgotten.value.response()
    assert answer is not None
    assert answer.status == 204
    assert asked(first, forgotten.value.url)["state"] == "cancelled"
    assert first.get_by_role("button", name="Find the light").is_enabled()


def test_a_narrow_screen_needs_no_sideways_scroll(new_page: MakePage, portrait: Path) -> None:
    page = new_page(viewport={"width": 360, "height": 740})
    assert page.evaluate(_OVERFLOW) == 0
    choose_photo(page, portrait)
    page.get_by_role("button", name="The face").wait_for()
    assert page.evaluate(_OVERFLOW) == 0
