"""How fast the studio's relit portrait follows the sun.

    python -m tools.measure_relit_frames

Starts a studio and a headless Chromium, uploads scikit-image's astronaut at 0.92 megapixels, has
its light found and its person taken apart, and drags the sun round over the panorama. Each frame
in which the canvas shows another sun counts; the time of a frame is that between two of them, and
frames a second are over all of the time from the first to the last. The browser begins a frame
only when the one before is drawn, but for one or two. The page's own time is the mean of what its
callbacks of animation frames take. Writes
``benchmarks/results/relit-frames.json``.
"""

import argparse
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright
from skimage.data import astronaut

from tools.measured import write_measured

SIDE = 960  # pixels of the photograph
PATIENCE_MS = 600_000
STEP_DEG = 6.0  # of the sun's round, from one place of the pointer to the next
# what the page shows in each frame, and how long its own callbacks take
_WATCH = """() => {
    const ask = window.requestAnimationFrame.bind(window);
    window.own = 0, window.shown = [];
    window.requestAnimationFrame = callback => ask(time => {
        const begun = performance.now();
        callback(time);
        own += performance.now() - begun;
    });
    const look = time => {
        const sun = document.querySelector(".relit")?.dataset.shows;
        if (sun !== window.last) shown.push(performance.now());
        window.last = sun;
        ask(look);
    };
    ask(look);
}"""
_BEGIN = "() => { window.own = 0; shown.length = 0; }"
_END = """() => {
    const canvas = document.querySelector(".relit");
    const gl = canvas.getContext("webgl2");
    const names = gl.getExtension("WEBGL_debug_renderer_info");
    const box = canvas.getBoundingClientRect();
    return {
        shown, own,
        renderer: gl.getParameter(names.UNMASKED_RENDERER_WEBGL),
        drawn: `${canvas.width} x ${canvas.height}`,
        on_screen: `${Math.round(box.width)} x ${Math.round(box.height)}`,
    };
}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--chromium", default=shutil.which("chromium"), help="its program")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/relit-frames.json"))
    options = parser.parse_args()
    begun = time.time()
    with tempfile.TemporaryDirectory(prefix="skylight-frames-") as folder:
        photo = Path(folder) / "portrait.png"
        Image.fromarray(astronaut()).resize((SIDE, SIDE), Image.Resampling.BICUBIC).save(photo)
        studio = subprocess.Popen(
            [sys.executable, "-m", "skylight", "studio", "--no-browser", "--port", "0"],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        try:
            assert studio.stdout is not None
            facts = measured(studio.stdout.readline().strip(), photo, options)
        finally:
            studio.terminate()
            studio.wait(timeout=60)
    write_measured(
        options.out,
        name=options.out.stem,
        what="The sun of a portrait dragged in the studio, in headless Chromium",
        command=f"python -m tools.measure_relit_frames --seconds {options.seconds:g}",
        begun=begun,
        facts=facts,
    )


def measured(address: str, photo: Path, options: argparse.Namespace) -> dict[str, object]:
    """Of a studio there, with that photograph."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=options.chromium, args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(address)
        page.set_input_files("input[type=file]", photo)
        page.locator("input[value=sunsky]").check()
        page.get_by_role("button", name="Find the light").click()
        page.get_by_role("button", name="Move the sun in the portrait").click()
        page.locator(".relit[data-shows]").wait_for()
        page.evaluate(_WATCH)
        _drag(page, 3.0)  # shaders are compiled, and the page's functions
        page.evaluate(_BEGIN)
        load = os.getloadavg()[0]
        _drag(page, options.seconds)
        told = page.evaluate(_END)
        version = browser.version
        browser.close()
    between = np.diff(told["shown"])
    return {
        "chromium": version,
        "renderer": told["renderer"],
        "cores": os.cpu_count(),
        "load_average": load,
        "picture_pixels": f"{SIDE} x {SIDE}",
        "screen_pixels": told["on_screen"],
        "last_drawn_pixels": told["drawn"],
        "frames": len(told["shown"]),
        "frames_per_second": float(1000 / between.mean()),
        "frame_ms": _quantiles(between),
        "own_ms": told["own"] / len(told["shown"]),
    }


def _drag(page: Page, seconds: float) -> None:
    """The sun round an ellipse over the upper half of the panorama; released at the end."""
    handle, frame = page.get_by_role("button", name="Sun: "), page.locator(".relit-grid .panorama")
    handle.scroll_into_view_if_needed()
    box, around = handle.bounding_box(), frame.bounding_box()
    assert box is not None
    assert around is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    begun, angle = time.monotonic(), 0.0
    while time.monotonic() - begun < seconds:
        angle += math.radians(STEP_DEG)
        x = around["x"] + (0.5 + 0.4 * math.cos(angle)) * around["width"]
        y = around["y"] + (0.27 + 0.15 * math.sin(angle)) * around["height"]
        page.mouse.move(x, y)
    page.mouse.up()


def _quantiles(values: np.ndarray) -> dict[str, float]:
    return {
        name: float(np.quantile(values, at))
        for name, at in (("median", 0.5), ("q90", 0.9), ("most", 1.0))
    }


if __name__ == "__main__":
    main()
