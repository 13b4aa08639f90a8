"""The whole path of a photo in a real browser, and what its owner sees when something fails."""

import base64
import json
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
from tests.studio.browser.pictures import FOR_DOCUMENTATION, picture
from tests.studio.browser.test_browser_access import OVERFLOW
from tests.studio.browser.waiting import expect, gathered, painted
from tests.studio.conftest import Served

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page, Route

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
# notes whatever the panel of a job shows, however soon it is gone again
_WATCH = """() => {
    const panel = document.querySelector(".job");
    const parts = [...panel.querySelectorAll("[role=status], button, progress")];
    const shown = () => parts.filter((one) => one.checkVisibility());
    window.told = [];
    const note = () => window.told.push(shown().map((one) => one.textContent || one.localName));
    const watched = { attributes: true, childList: true, subtree: true };
    new MutationObserver(note).observe(panel, watched);
}"""
# whether a job is cancelled, done, or forgotten
_IS_OVER = """async (path) => {
    const { state } = await (await fetch(path)).json();
    return !["waiting", "running"].includes(state);
}"""


@pytest.fixture(scope="module")
def portrait_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("photos") / "portrait.jpg"
    whole = astronaut()
    codes = whole if FOR_DOCUMENTATION else whole[:256, 96:352]
    Image.fromarray(codes).save(path, quality=92)
    return path


def choose_photo(page: "Page", path: Path) -> None:
    page.locator("input[type=file][accept^='image']").set_input_files(path)


def drop(page: "Page", path: Path, place: str = ".drop") -> None:
    page.evaluate(_DROP, [place, base64.b64encode(path.read_bytes()).decode(), path.name])


def estimated(page: "Page", light: str) -> dict[str, Any]:
    """Finds the light with that model; the job as the server then describes it."""
    choose_model(page, light)
    count = lights(page).count()
    with page.expect_response("**/api/jobs") as started:
        page.locator("button.primary", has_text=re.compile("Find .* light")).click()
    job = started.value.json()["job"]
    lights(page).nth(count).wait_for(state="attached")
    page.locator(".side .verdict").wait_for()
    return asked(page, f"/api/jobs/{job}")


def choose_model(page: "Page", light: str) -> None:
    tab = page.get_by_role("tab", name="Photo")
    if tab.count():
        tab.click()
    models = page.get_by_label("Model of the light")
    if not models.is_visible():
        page.get_by_text("More", exact=True).click()
    models.select_option(light)


def lights(page: "Page") -> "Locator":
    """Those that were found."""
    return page.get_by_label("Light shown").locator("option")


def see(page: "Page", tab: str) -> None:
    page.get_by_role("tab", name=tab).click()


def paste(page: "Page", path: Path) -> None:
    page.evaluate(_PASTE, [base64.b64encode(path.read_bytes()).decode(), path.name])


def asked(page: "Page", path: str) -> dict[str, Any]:
    """What the server answers the page."""
    return page.evaluate("path => fetch(path).then((answer) => answer.json())", path)


def test_from_a_dropped_photo_to_a_downloaded_map(
    new_page: MakePage, studio_address: str, portrait_file: Path, tmp_path: Path, pictures: Path
) -> None:
    page = new_page(webgl=False, color_scheme="light", accept_downloads=True)
    page.get_by_role("region", name="Try one of these").wait_for()
    if FOR_DOCUMENTATION:
        page.wait_for_load_state("networkidle")  # with their pictures
        picture(page, pictures / "studio_start.png")
    (tmp_path / "notes.jpg").write_text("dear diary")
    drop(page, tmp_path / "notes.jpg")
    expect(page.locator(LINE)).to_contain_text("picture", ignore_case=True)
    drop(page, portrait_file)
    page.get_by_role("button", name="The face").wait_for()
    choose_model(page, "sh9")
    page.evaluate(_WATCH)
    page.get_by_role("button", name="Find the light").click()
    if FOR_DOCUMENTATION:
        page.get_by_role("status").get_by_text(re.compile("(Tracing|Estimating) .*…")).wait_for()
        picture(page, pictures / "studio_faces.png")
    page.locator(".side .verdict").wait_for()
    stage = re.compile("(Fitting|Tracing|Estimating|Writing) .*…")
    told = [words for words in page.evaluate("window.told") if words and stage.match(words[0])]
    assert told
    assert all(words[1:] == ["Cancel", "progress"] for words in told)
    for gone in (page.get_by_role("progressbar"), page.get_by_role("button", name="Cancel")):
        expect(gone).to_be_hidden()

    see(page, "Result")
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
    assert environment.radiance.shape == (256, 512, 3)
    assert float(environment.radiance.max()) > 0

    with page.expect_download() as download:
        page.get_by_role("link", name="all files.zip").click()
    download.value.save_as(tmp_path / "all.zip")
    with ZipFile(tmp_path / "all.zip") as packed:
        names = set(packed.namelist())
        told = json.loads(packed.read("estimate.json"))
    listed = page.locator("ul.files a").evaluate_all("links => links.map(a => a.download)")
    assert names | {"all files.zip"} == set(listed)
    height = page.locator("dt:text('Height') + dd").text_content() or ""
    assert height.startswith(f"{round(abs(90 - told['sun']['zenith_deg']))}°")

    # another page and back: the result is still there
    page.goto(f"{studio_address}/#/codes")
    page.get_by_role("heading", level=1, name="Light in few pieces").wait_for()
    page.goto(f"{studio_address}/#/face")
    expect(page.locator(".side .verdict")).to_have_count(1)


@pytest.mark.slow
def test_a_second_light_beside_the_first(
    new_page: MakePage, portrait_file: Path, pictures: Path
) -> None:
    """The object is lit by the newer one."""
    page = new_page(color_scheme="light")
    choose_photo(page, portrait_file)
    estimated(page, "sh9")
    second = "autoencoder" if FOR_DOCUMENTATION else "sh25"
    job = estimated(page, second)
    assert job["result"]["light"] == second
    expect(lights(page)).to_have_count(2)
    shown = page.get_by_label("Light shown")
    titles = lights(page).all_text_contents()
    expect(shown).to_have_value(titles[1])
    light = page.locator(".side .panorama canvas")
    second_light = light.get_attribute("aria-label") or ""
    assert second_light.startswith(f"{titles[1]}: ")
    shown.select_option(titles[0])
    expect(light).to_have_attribute("aria-label", re.compile(f"^{re.escape(titles[0])}: "))
    shown.select_option(titles[1])
    expect(light).to_have_attribute("aria-label", second_light)
    gathered(page, 1 if FOR_DOCUMENTATION else 1 / 8)
    if FOR_DOCUMENTATION:
        picture(page, pictures / "studio_photo.png")
        see(page, "Map")
        painted(page)
        picture(page, pictures / "studio_lights.png")
        page.emulate_media(color_scheme="dark")
        see(page, "Result")
        picture(page, pictures / "studio_dark.png")


@pytest.mark.slow
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
    expect(row).to_have_count(0)  # they give way to the photo, until that is closed
    page.get_by_role("button", name="Close this photo").click()
    row.get_by_role("button", name=re.compile("astronaut.* Works: .*NASA")).click()
    page.get_by_role("img", name="Your photo, astronaut.png").wait_for()
    expect(page.get_by_role("button", name="Find the light")).to_be_enabled()


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
    expect(first).to_have_attribute("aria-pressed", "false")
    expect(everyone).to_have_attribute("aria-pressed", "true")
    second.click()
    expect(second).to_have_attribute("aria-pressed", "true")
    job = estimated(page, "sh9")
    assert [face["number"] for face in job["result"]["faces"]] == [2]
    expect(lights(page)).to_have_text(["Spherical harmonics, 9 coefficients, face 2"])


@pytest.mark.slow
def test_files_that_are_no_use(new_page: MakePage, portrait_file: Path, tmp_path: Path) -> None:
    """On a narrow screen, which needs no sideways scroll."""
    page = new_page(viewport={"width": 360, "height": 740})
    page.get_by_role("region", name="Try one of these").wait_for()
    assert page.evaluate(OVERFLOW) == 0
    line = page.locator(LINE)
    (tmp_path / "heavy.png").write_bytes(bytes(1_100_000))
    choose_photo(page, tmp_path / "heavy.png")
    line.get_by_text("heavy.png is larger than 1 MB").wait_for()

    Image.new("L", (1000, 600)).save(tmp_path / "wide.png")
    choose_photo(page, tmp_path / "wide.png")
    line.get_by_text("million pixels").wait_for()

    Image.fromarray(camera()).convert("1").save(tmp_path / "bits.png")
    choose_photo(page, tmp_path / "bits.png")
    line.get_by_text("one bit a pixel").wait_for()

    Image.fromarray(coffee()).save(tmp_path / "empty.png")
    choose_photo(page, tmp_path / "empty.png")
    page.get_by_role("alert").get_by_text("No face was found").wait_for()
    expect(page.locator("button", has_text="Find the light")).to_have_count(0)

    choose_photo(page, portrait_file)  # the page is still of use
    page.get_by_role("button", name="The face").wait_for()
    page.get_by_role("radio").first.wait_for()
    expect(line).to_have_count(0)
    assert page.evaluate(OVERFLOW) == 0


@pytest.mark.slow
def test_a_job_that_fails_and_a_server_that_is_gone(
    new_page: MakePage, portrait_file: Path
) -> None:
    page = new_page()
    choose_photo(page, portrait_file)
    start = page.get_by_role("button", name="Find the light")
    line = page.locator(LINE)

    def ask_for_another_face(route: "Route") -> None:
        body = json.loads(route.request.post_data or "")
        route.continue_(post_data=json.dumps({**body, "face": 7}))

    page.route("**/api/jobs", ask_for_another_face)
    start.click()
    line.get_by_text(re.compile("face", re.IGNORECASE)).wait_for()
    expect(page.get_by_role("progressbar")).to_be_hidden()
    page.unroute("**/api/jobs")

    page.route("**/events", lambda route: route.abort())
    with page.expect_response("**/api/jobs") as started:
        start.click()
    line.get_by_text("The studio does not answer").wait_for()
    page.wait_for_function(_IS_OVER, arg=f"/api/jobs/{started.value.json()['job']}", polling=100)
    page.unroute("**/events")

    page.context.set_offline(True)
    choose_photo(page, portrait_file)
    expect(line.get_by_text("The studio does not answer")).to_have_count(2)  # the photo's, too
    page.context.set_offline(False)
    choose_photo(page, portrait_file)
    expect(line).to_have_count(0)
    expect(start).to_be_enabled()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
def test_too_many_jobs_and_a_cancelled_one(
    new_page: MakePage, studio: Served, portrait_file: Path, photo: str
) -> None:
    first, second = new_page(), new_page()
    for page in (first, second):
        choose_photo(page, portrait_file)
        page.get_by_role("button", name="Find the light").wait_for()
    cancel = first.get_by_role("button", name="Cancel")
    with studio.client() as client, studio.held():
        # the studio takes two jobs, and this one is another user's
        other = client.post("/api/jobs", json={"kind": "estimate", "photo": photo}).json()["job"]
        with first.expect_response("**/api/jobs"):
            first.get_by_role("button", name="Find the light").click()
        second.get_by_role("button", name="Find the light").click()
        second.locator(LINE).get_by_text("jobs are waiting or running").wait_for()
        with first.expect_request(lambda request: request.method == "DELETE") as forgotten:
            cancel.click()
        expect(cancel).to_be_hidden()
        answer = forgotten.value.response()
        assert answer is not None
        assert answer.status == 204
        assert asked(first, forgotten.value.url)["state"] == "cancelled"
        client.delete(f"/api/jobs/{other}")
    expect(first.get_by_role("button", name="Find the light")).to_be_enabled()
    expect(first.locator(LINE)).to_have_count(0)  # it was the user's wish


@pytest.mark.slow
def test_who_waits_sees_how_many_are_before(new_page: MakePage, portrait_file: Path) -> None:
    told = {"job": "it", "kind": "estimate", "state": "waiting", "stage": "", "share": 0}

    def wait_behind(before: int) -> None:
        body = f"data: {json.dumps({**told, 'before': before})}\n\n"
        page.unroute_all()
        page.route(  # the page asks again and again
            "**/events", lambda route: route.fulfill(body=body, content_type="text/event-stream")
        )

    page = new_page()
    choose_photo(page, portrait_file)
    wait_behind(2)
    page.get_by_role("button", name="Find the light").click()
    status = page.locator(".job [role=status]")
    expect(status).to_have_text("2 jobs before yours …")
    wait_behind(1)
    expect(status).to_have_text("1 job before yours …")
    wait_behind(0)
    expect(status).to_have_text("Starting …")
    page.get_by_role("button", name="Cancel").click()
    expect(status).to_be_hidden()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
def test_a_stream_that_falls_silent(
    new_page: MakePage, studio: Served, portrait_file: Path
) -> None:
    page = new_page()
    choose_photo(page, portrait_file)
    page.get_by_role("button", name="Find the light").wait_for()
    page.clock.install()
    with studio.held():
        with page.expect_response("**/events"):
            page.get_by_role("button", name="Find the light").click()
        page.clock.fast_forward(55_000)
        expect(page.locator(".job [role=status]")).to_have_text("Starting …")
        expect(page.locator(LINE)).to_have_count(0)
        page.clock.fast_forward(61_000)
        page.locator(LINE).get_by_text("The studio does not answer").wait_for()
