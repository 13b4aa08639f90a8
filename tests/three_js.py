"""The three.js that the studio is built from, for tests; they skip where it is not installed."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

STUDIO = Path(__file__).resolve().parents[1] / "studio"
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
# WebGL in software: machines of CI have no graphics card
CHROMIUM_OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def run_in_node(program: str, content: object) -> Any:
    """What a module prints as JSON; ``content`` is JSON on its standard input."""
    node = shutil.which("node")
    if node is None or not (STUDIO / "node_modules" / "three").is_dir():
        pytest.skip("three.js is not installed: run npm ci in studio/")
    ended = subprocess.run(
        [node, "--input-type=module", "--eval", program],
        input=json.dumps(content),
        cwd=STUDIO,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@contextmanager
def browser_page(folder: Path) -> Iterator[Any]:
    """A page of a headless Chromium with software WebGL; ``folder`` is served as /files/."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if program is None:
        pytest.skip("no Chromium is installed")
    if not (STUDIO / "node_modules" / "three").is_dir():
        pytest.skip("three.js is not installed: run npm ci in studio/")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Files, folder))
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=program,
                args=CHROMIUM_OPTIONS,
            )
            page = browser.new_page()
            page.goto(f"http://127.0.0.1:{server.server_port}/files/page.html")
            yield page
            browser.close()
    finally:
        server.shutdown()
        server.server_close()


class _Files(SimpleHTTPRequestHandler):
    def __init__(self, folder: Path, *arguments: Any) -> None:
        self.folder = folder
        super().__init__(*arguments)

    def translate_path(self, path: str) -> str:
        root, _, rest = path.lstrip("/").partition("/")
        return str((self.folder if root == "files" else STUDIO / root) / rest)

    def log_message(self, format: str, *args: Any) -> None:
        pass
