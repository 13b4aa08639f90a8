"""The studio under load: browsers that upload, estimate, look, cancel and go away at random.

    python -m tools.load_studio --browsers 8 --minutes 20

Starts a studio at a free port of 127.0.0.1 and, in one headless Chromium, contexts that share
nothing (as separate browsers would) with a page each. What each does is drawn from the seed; how
their deeds interleave is not. Nothing new begins after the minutes or ``--most`` deeds; what has
begun is waited for. Writes ``benchmarks/results/studio-load.json``; the exit code is 1 where
anything was lost or failed. `python -m tools.load.table` brings the documentation up to date.
"""

import argparse
import asyncio
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import astuple
from pathlib import Path

import httpx
import torch
from PIL import Image
from playwright.async_api import async_playwright
from skimage.data import astronaut, coffee

from skylight.evaluation._main import commit
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from tools.load.memory import Sampler, trend
from tools.load.tally import Tally
from tools.load.visitor import PATIENCE_S, Bounds, Materials, Visitor
from tools.measured import write_measured

PICTURE = 480  # pixels of a side


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--browsers", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--most", type=int, default=2000, help="deeds of all of them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--chromium", default=shutil.which("chromium"), help="its program")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/studio-load.json"))
    options = parser.parse_args()
    begun, commit_ = time.time(), commit()  # that of the start: the run is long
    with tempfile.TemporaryDirectory(prefix="skylight-load-") as folder:
        facts = loaded(options, Path(folder))
    write_measured(
        options.out,
        name=options.out.stem,
        what="The studio with many pages at once, which upload, ask for jobs, cancel and go away; "
        "memory in 10^6 bytes, its slope over the second half of the time",
        command=f"python -m tools.load_studio --browsers {options.browsers} "
        f"--minutes {options.minutes:g} --seed {options.seed}",
        begun=begun,
        facts={
            "commit": commit_,
            "seed": options.seed,
            "browsers": options.browsers,
            "minutes": options.minutes,
            "cores": os.cpu_count(),
            **facts,
        },
    )
    sys.exit(any(facts[name] for name in ("jobs_lost", "console_errors", "failures")))


def loaded(options: argparse.Namespace, folder: Path) -> dict[str, object]:
    """What happened to a studio, from its start to its end."""
    (temporary := folder / "temporary").mkdir()
    errors = folder / "stderr"
    with errors.open("w") as stream:
        studio = subprocess.Popen(
            [sys.executable, "-m", "skylight", "studio", "--no-browser", "--port", "0"],
            stdout=subprocess.PIPE,
            stderr=stream,
            text=True,
            env={**os.environ, "TMPDIR": str(temporary), "OMP_NUM_THREADS": "1"},
        )
    assert studio.stdout is not None
    tally = Tally()
    try:
        address = studio.stdout.readline().strip()
        sampler = Sampler(studio.pid)
        asyncio.run(_visited(options, address, _materials(folder), tally))
        sampler.end()
    finally:
        studio.send_signal(signal.SIGTERM)
        code = studio.wait(timeout=60)
    said, left = errors.read_text(), sorted(path.name for path in temporary.iterdir())
    if code != 0 or said or left:
        print(said, file=sys.stderr)
        lines = [line for line in said.replace(f"{folder}/", "").splitlines() if line[:1] != " "]
        tally.failures.append(f"the server ended with {code}, left {left}, said: {lines}")
    memory = {
        name: {**trend(samples), "minute_process_mb": [list(astuple(one)) for one in samples]}
        for name, samples in sampler.samples.items()
    }
    return {**tally.facts(), "memory": memory}


async def _visited(
    options: argparse.Namespace, address: str, materials: Materials, tally: Tally
) -> None:
    bounds = Bounds(until=time.monotonic() + 60 * options.minutes, most=options.most)
    async with (
        async_playwright() as driver,
        httpx.AsyncClient(base_url=address, timeout=PATIENCE_S) as asking,
    ):
        browser = await driver.chromium.launch(
            executable_path=options.chromium, args=["--no-sandbox"]
        )
        visitors = [
            Visitor(
                seed=f"{options.seed}/{number}",
                browser=browser,
                asking=asking,
                materials=materials,
                bounds=bounds,
                tally=tally,
            )
            for number in range(options.browsers)
        ]
        telling = asyncio.create_task(_tell(tally))
        ended = asyncio.gather(*(visitor.visit() for visitor in visitors))
        try:  # a page that does not close would be waited for without end
            await asyncio.wait_for(ended, 60 * options.minutes + 2 * PATIENCE_S)
        except TimeoutError:
            tally.failures.append("a visitor had not gone long after the time was over")
        telling.cancel()
        await browser.close()


async def _tell(tally: Tally) -> None:
    while True:
        await asyncio.sleep(30)
        print(dict(tally.counts), tally.failures[-1:], file=sys.stderr, flush=True)


def _materials(folder: Path) -> Materials:
    """Small files, so that it is the studio that is loaded."""
    portrait = Image.fromarray(astronaut()).resize((PICTURE, PICTURE))
    mirrored = portrait.transpose(Image.Transpose.FLIP_LEFT_RIGHT)
    darker = portrait.point(lambda code: 0.7 * code)
    pictures = {"portrait": portrait, "mirrored": mirrored, "darker": darker}
    for name, picture in pictures.items():
        picture.save(folder / f"{name}.jpg", quality=92)
    Image.fromarray(coffee()).resize((PICTURE, 320)).save(folder / "coffee.jpg")
    row = torch.linspace(2, 0.1, 32).reshape(32, 1, 1)
    light = EnvironmentMap(radiance=row.expand(32, 64, 3).contiguous())
    write_environment_map(folder / "light.hdr", light)
    faces = [folder / f"{name}.jpg" for name in pictures]
    return Materials(faces=faces, faceless=folder / "coffee.jpg", light=folder / "light.hdr")


if __name__ == "__main__":
    main()
