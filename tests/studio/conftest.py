"""A studio in a process of its own, as a user starts it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image
from skimage.data import astronaut

UPLOAD_MB, MEGAPIXELS, JOBS = 1.0, 0.5, 2
STAGES = (
    "reading the picture",
    "finding the face",
    "fitting the head",
    "tracing light",
    "estimating the light",
    "writing the results",
)
# beside this Python; started by -m, Python itself looks into the current folder
COMMAND = shutil.which("skylight", path=os.path.dirname(sys.executable))
HOSTILE = ("json", "numpy", "cv2")
PATIENCE_S = 300  # the machine may have other things to do


@dataclass(frozen=True, kw_only=True)
class Served:
    """A running studio, its address, and the folder in which it has its temporary one."""

    process: subprocess.Popen[str]
    address: str
    temporary: Path

    def client(self, **options: Any) -> httpx.Client:
        return httpx.Client(base_url=self.address, timeout=PATIENCE_S, **options)

    def workers(self) -> list[int]:
        """Processes that it started."""
        path = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        return [int(number) for number in path.read_text().split()]

    @contextmanager
    def held(self) -> Iterator[None]:
        """However fast the machine is, no work goes on meanwhile: both workers are stopped."""
        begun = time.monotonic()
        while len(stopped := [worker for worker in self.workers() if _stopped(worker)]) < 2:
            assert time.monotonic() - begun < PATIENCE_S
            time.sleep(0.01)
        try:
            yield
        finally:
            for worker in stopped:
                with suppress(ProcessLookupError):  # one that was killed
                    os.killpg(worker, signal.SIGCONT)

    def end(self, how: int = signal.SIGINT) -> int:
        """The exit code after that signal."""
        self.process.send_signal(how)
        return self.process.wait(timeout=PATIENCE_S)


def _stopped(worker: int) -> bool:
    """Whether it is by now, with all that it started; those that have ended never are."""
    with suppress(ProcessLookupError, FileNotFoundError):
        os.killpg(worker, signal.SIGSTOP)
        return Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[0] == "T"
    return False


def start(temporary: Path, *options: str) -> Served:
    """In a folder with modules that end whatever imports them, where the command is installed."""
    temporary.mkdir(exist_ok=True)
    command = [sys.executable, "-m", "skylight"]
    if COMMAND is not None:
        command = [COMMAND]
        for name in HOSTILE:
            (temporary.parent / f"{name}.py").write_text("raise SystemExit('run')")
    process = subprocess.Popen(
        [*command, "studio", "--no-browser", "--port", "0", *options],
        cwd=temporary.parent,
        stdout=subprocess.PIPE,
        stderr=(temporary.parent / "stderr").open("w"),
        text=True,
        env={**os.environ, "TMPDIR": str(temporary), "OMP_NUM_THREADS": "1"},
    )
    assert process.stdout is not None
    return Served(process=process, address=process.stdout.readline().strip(), temporary=temporary)


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One for all tests, with low limits."""
    limits = ("--upload-mb", str(UPLOAD_MB), "--megapixels", str(MEGAPIXELS), "--jobs", str(JOBS))
    studio = start(tmp_path_factory.mktemp("studio"), *limits)
    yield studio
    studio.end()


@pytest.fixture
def client(served: Served) -> Iterator[httpx.Client]:
    with served.client() as client:
        yield client
        for job in _begun.pop(client, []):
            while client.delete(f"/api/jobs/{job}").status_code == 204:
                pass


_begun: dict[httpx.Client, list[str]] = {}


@pytest.fixture(scope="session")
def portrait() -> bytes:
    """A photograph of one face, as a JPEG file."""
    buffer = BytesIO()
    Image.fromarray(astronaut()).save(buffer, format="JPEG", quality=95)
    return buffer.getvalue()


@pytest.fixture(scope="session")
def photo(served: Served, portrait: bytes) -> str:
    """Its id on the server."""
    with served.client() as client:
        return client.post("/api/photos?name=me.jpg", content=portrait).json()["photo"]


@pytest.fixture(scope="session")
def estimated(served: Served, photo: str) -> list[dict[str, Any]]:
    """All that was told of one estimate of it, whose light are lamps; its job stays."""
    with served.client() as client:
        job = client.post("/api/jobs", json={"kind": "estimate", "photo": photo, "light": "lamps"})
        return list(events(client, job.json()["job"]))


def begin(client: httpx.Client, **wanted: Any) -> str:
    """The id of a new job, which is cancelled or forgotten after the test."""
    answer = client.post("/api/jobs", json=wanted)
    assert answer.status_code == 202, answer.text
    job = answer.json()["job"]
    _begun.setdefault(client, []).append(job)
    return job


def events(client: httpx.Client, job: str) -> Generator[dict[str, Any], None, None]:
    """What the stream of a job's events tells."""
    with client.stream("GET", f"/api/jobs/{job}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            if line:
                assert line.startswith("data: ")
                yield json.loads(line.removeprefix("data: "))


def finished(client: httpx.Client, **wanted: Any) -> dict[str, Any]:
    """The description of a job that was done to its end."""
    *_, last = events(client, begin(client, **wanted))
    return last
