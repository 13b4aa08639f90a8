"""One who uses the studio: comes, uploads, asks for jobs, looks, cancels, goes away; by a seed."""

import asyncio
import random
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
from playwright.async_api import Browser, ConsoleMessage, Page, Response, TimeoutError

from skylight.studio.tasks._sky import NAMES
from tools.load.tally import Tally

PATIENCE_S = 420.0  # for a job behind three others on a busy machine
_PAGE_S = 90.0  # for what a page does by itself
_OVER = ("done", "failed", "cancelled")
_ENOUGH_GONE_S = 20.0  # 5 s after its page is gone a job is cancelled, on a busy machine later
_NEVER_OPENED_S = 75.0  # 60 s, and then some
_REFUSED = "the server responded with a status of 429"
# what a page hears of its jobs, and when
WATCH = """(() => {
    const seen = (window.jobsSeen = {});
    window.EventSource = class extends window.EventSource {
        constructor(url) {
            super(url);
            const now = performance.now();
            const job = { asked: now, last: now, gap: 0, before: 0, began: null, state: "" };
            seen[url.split("/").at(-2)] = job;
            this.addEventListener("message", (event) => {
                const now = performance.now();
                const told = JSON.parse(event.data);
                job.gap = Math.max(job.gap, now - job.last);
                job.last = now;
                job.state = told.state;
                job.error = told.error;
                if (told.state === "waiting") job.before = Math.max(job.before, told.before);
                else job.began ??= now;
            });
        }
    };
})()"""
_SLIDE = "(it, value) => { it.value = value; it.dispatchEvent(new Event('input')); }"
_HEARD = "job => window.jobsSeen[job]?.state"
_IS_OVER = "job => ['done', 'failed', 'cancelled'].includes(window.jobsSeen[job]?.state)"


@dataclass(frozen=True, kw_only=True)
class Materials:
    """Files to upload: pictures of a face, a picture of none, a small map of light."""

    faces: list[Path]
    faceless: Path
    light: Path


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """No deed begins after ``until`` (of ``time.monotonic``), nor after ``most`` of all."""

    until: float
    most: int


class Visitor:
    """Visits until the bounds are reached; what happens goes to ``tally``."""

    def __init__(
        self,
        *,
        seed: str,
        browser: Browser,
        asking: httpx.AsyncClient,
        materials: Materials,
        bounds: Bounds,
        tally: Tally,
    ) -> None:
        self._random = random.Random(seed)
        self._browser, self._asking, self._materials = browser, asking, materials
        self._bounds, self._tally = bounds, tally
        self._watching: list[asyncio.Task[None]] = []
        # how often each is done
        self._deeds: dict[Callable[[Page], Awaitable[None]], int] = {
            self._estimate: 8,
            self._look_at_the_sky: 3,
            self._code: 4,
            self._make_voxel_probe: 3,
            self._make_partitions_probe: 3,
            self._upload_faceless: 2,
            self._upload_slowly: 2,
            self._ask_and_vanish: 2,
        }

    async def visit(self) -> None:
        """To the end, that of the last job included."""
        while not self._is_time():
            page = await self._arrive()
            for _ in range(self._random.randint(1, 4)):
                if page.is_closed() or self._is_time():
                    break
                (deed,) = self._random.choices([*self._deeds], [*self._deeds.values()])
                self._count("deeds")
                try:
                    await deed(page)
                except Exception as error:  # the record tells it; the others go on
                    name = deed.__name__.strip("_")  # type: ignore[attr-defined]
                    self._tally.failures.append(f"{name}: {' '.join(str(error).split())[:400]}")
                    break
            await page.context.close()
        await asyncio.gather(*self._watching)

    def _is_time(self) -> bool:
        enough = self._tally.counts["deeds"] >= self._bounds.most
        return enough or time.monotonic() >= self._bounds.until

    def _count(self, what: str) -> None:
        self._tally.counts[what] += 1

    async def _arrive(self) -> Page:
        context = await self._browser.new_context(viewport={"width": 900, "height": 700})
        await context.add_init_script(WATCH)
        page = await context.new_page()
        page.set_default_timeout(1000 * _PAGE_S)
        page.on("console", self._hear)
        page.on("pageerror", lambda error: self._tally.console_errors.append(str(error)))
        await page.goto(str(self._asking.base_url))
        await page.wait_for_selector("h1")
        self._count("pages")
        return page

    def _hear(self, message: ConsoleMessage) -> None:
        if message.type == "error" and _REFUSED not in message.text:  # refusals are counted
            self._tally.console_errors.append(message.text)

    async def _open(self, page: Page, name: str) -> None:
        await page.evaluate("name => { location.hash = `#/${name}`; }", name)
        await page.locator(f"nav a[href='#/{name}'][aria-current=page]").wait_for()

    # Deeds

    async def _estimate(self, page: Page) -> None:
        await self._open(page, "face")
        await self._upload(page, self._random.choice(self._materials.faces), "input[accept^=image]")
        light = self._random.choices(["sh9", "sh25", "sunsky", "lamps"], [6, 2, 1, 1])[0]
        await page.get_by_role("button", name="Find the light").wait_for()  # that of this photo
        await page.get_by_text("More", exact=True).click()
        await page.get_by_label("Model of the light").select_option(light)
        if await self._run(page, "estimate", "Find the light"):
            await page.get_by_role("region", name="Verdict").wait_for()
            photo = page.get_by_label("Your photo with the object")
            await photo.or_(page.locator("[role=tabpanel] .care")).first.wait_for()
            if await photo.count() == 0:
                said = await page.locator("[role=tabpanel] .care").all_inner_texts()
                raise AssertionError(f"no object stands in the photo: {said}")
            await photo.press("ArrowLeft")
            await page.get_by_role("tab", name="Map").click()
            await self._slide(page, "Exposure of the views")

    async def _look_at_the_sky(self, page: Page) -> None:
        await self._open(page, "sky")
        await page.get_by_label(NAMES[0]).wait_for()
        for name in self._random.sample(NAMES, 3):
            await self._slide(page, name)
        await page.get_by_role("button", name="Random sky").click()
        self._count("skies")

    async def _code(self, page: Page) -> None:
        await self._open(page, "codes")
        await self._upload(page, self._materials.light, "input[accept='.exr,.hdr']")
        await page.get_by_label("Shape of the pieces").select_option("iso")
        await self._slide(page, "Pieces at most", least=1, most=12)
        await self._run_and_see_files(page, "code", "Take it apart")

    async def _make_voxel_probe(self, page: Page) -> None:
        await self._make_probe(page, "voxel")

    async def _make_partitions_probe(self, page: Page) -> None:
        await self._make_probe(page, "partitions")

    async def _make_probe(self, page: Page, kind: str) -> None:
        await self._open(page, kind)
        if self._random.random() < 0.5:
            await self._upload(page, self._materials.light, "input[accept='.exr,.hdr']")
        await self._run_and_see_files(page, kind, "Make the probe")

    async def _upload_faceless(self, page: Page) -> None:
        await self._open(page, "face")
        await self._upload(page, self._materials.faceless, "input[accept^=image]")
        await page.get_by_text("No face was found").wait_for()

    async def _upload_slowly(self, _page: Page) -> None:
        """Some bytes a second, which the server must refuse."""
        place = urlsplit(str(self._asking.base_url))
        reader, writer = await asyncio.open_connection(place.hostname, place.port)
        head = f"POST /api/photos?name=slow.jpg HTTP/1.1\r\nHost: {place.netloc}\r\n"
        writer.write(f"{head}Content-Length: 100000\r\n\r\n".encode())
        answer = asyncio.create_task(reader.readline())
        with suppress(ConnectionError):
            while not answer.done():
                writer.write(b"x")
                await writer.drain()
                await asyncio.wait([answer], timeout=1)
        status = (await answer).split(b" ")[1].decode()
        writer.close()
        if status not in ("408", "429"):  # the latter while four others upload
            raise AssertionError(f"a slow upload was answered with {status}")
        self._count(f"slow_uploads_answered_{status}")

    async def _ask_and_vanish(self, _page: Page) -> None:
        """A job whose events nobody opens."""
        answer = await self._asking.post("/api/jobs", json={"kind": "voxel", "probe": 1})
        if answer.status_code == 429:
            self._count("jobs_refused")
            return
        self._count("jobs_never_watched")
        self._watching.append(asyncio.create_task(self._ends_unwatched(answer.json()["job"])))

    async def _ends_unwatched(self, job: str) -> None:
        await asyncio.sleep(_NEVER_OPENED_S)  # asking for it sooner would keep it
        state = await self._state(job)
        if state not in _OVER:
            self._tally.failures.append(f"a job that nobody watched is {state} after a minute")

    # Parts of them

    async def _slide(self, page: Page, label: str, *, least: int = -1, most: int = 1) -> None:
        await page.get_by_label(label).first.evaluate(_SLIDE, self._random.randint(least, most))

    async def _upload(self, page: Page, file: Path, place: str) -> None:
        """Until it is taken: refused ones are tried again."""
        while True:
            async with page.expect_response(_is_upload) as answered:
                await page.locator(place).first.set_input_files(file)
            status = (await answered.value).status
            if status == 201:
                self._count("uploads")
                return
            if status != 429:
                raise AssertionError(f"an upload was answered with {status}")
            self._count("uploads_refused")
            await asyncio.sleep(self._random.uniform(0.5, 3))

    async def _run_and_see_files(self, page: Page, kind: str, button: str) -> None:
        if await self._run(page, kind, button):
            await page.get_by_role("heading", name="Files").wait_for()

    async def _run(self, page: Page, kind: str, button: str) -> bool:
        """Has a job done, or leaves it on the way; whether it was done."""
        job = await self._begun(page, button)
        self._count(f"jobs_{kind}")
        await page.wait_for_function(_HEARD, arg=job)
        chance = self._random.random()
        if chance < 0.7:
            await self._wait(page, job, kind)
            return True
        await asyncio.sleep(self._random.uniform(0, 6))
        if chance < 0.85:
            await self._cancel(page, job)
        else:
            await self._leave(page, job)
        return False

    async def _begun(self, page: Page, button: str) -> str:
        """The id of the job, once there is room for it."""
        refused_until = time.monotonic() + PATIENCE_S
        while True:
            async with page.expect_response(_is_new_job) as answered:
                await page.get_by_role("button", name=button).click()
            answer = await answered.value
            if answer.status == 202:
                return (await answer.json())["job"]
            if answer.status != 429 or time.monotonic() > refused_until:
                raise AssertionError(f"a job was answered with {answer.status}")
            self._count("jobs_refused")
            await asyncio.sleep(self._random.uniform(1, 5))

    async def _wait(self, page: Page, job: str, kind: str) -> None:
        """For its end and all its files."""
        self._tally.lost.append(job)
        await page.wait_for_function(_IS_OVER, arg=job, timeout=1000 * PATIENCE_S)
        seen = (await page.evaluate("() => window.jobsSeen"))[job]
        if seen["state"] != "done":
            raise AssertionError(f"{kind}: {seen['state']}: {seen.get('error')}")
        self._tally.stream(seen)
        told = (await self._asking.get(f"/api/jobs/{job}")).json()
        if not told["files"]:
            raise AssertionError(f"{kind}: done without files")
        for file in told["files"]:
            content = await self._asking.get(f"/api/jobs/{job}/files/{file['name']}")
            if content.status_code != 200 or len(content.content) != file["size"]:
                raise AssertionError(f"{kind}: {file['name']} is not what was told of it")
        self._tally.lost.remove(job)
        self._count("jobs_done")

    async def _cancel(self, page: Page, job: str) -> None:
        while not await page.evaluate(_IS_OVER, job):
            with suppress(TimeoutError):  # it may just have been done
                await page.get_by_role("button", name="Cancel").click(timeout=2000)
                break
        self._count("jobs_cancelled")
        await self._ends(job, time.monotonic(), "cancelled it")

    async def _leave(self, page: Page, job: str) -> None:
        self._count("jobs_left")
        how = "closed its context" if self._random.random() < 0.5 else "went to another address"
        await (page.context.close() if how[0] == "c" else page.goto("about:blank"))
        left = time.monotonic()
        self._watching.append(asyncio.create_task(self._ends(job, left, how)))
        if not page.is_closed():
            await page.context.close()

    async def _ends(self, job: str, since: float, how: str) -> None:
        """Sees that it does, soon."""
        while (state := await self._state(job)) not in _OVER:
            if time.monotonic() - since > _ENOUGH_GONE_S:
                self._tally.failures.append(f"a job whose page {how} is still {state}")
                return
            await asyncio.sleep(0.5)
        if state == "cancelled":
            self._tally.until_cancelled_s.append(time.monotonic() - since)

    async def _state(self, job: str) -> str:
        answer = await self._asking.get(f"/api/jobs/{job}")
        told: dict[str, Any] = answer.json()
        return "done" if answer.status_code == 404 else told["state"]  # done, and forgotten


def _is_upload(response: Response) -> bool:
    path = urlsplit(response.url).path
    return response.request.method == "POST" and path in ("/api/photos", "/api/maps")


def _is_new_job(response: Response) -> bool:
    return response.request.method == "POST" and urlsplit(response.url).path == "/api/jobs"
