"""Install relighting alone into an empty environment, then the wheel, and use both as users would.

    python tools/try_wheel.py

Uses this interpreter's ``build`` for the wheel, and this environment's skylight for the estimate
that the wheel's must equal. Everything happens in a temporary folder, far from the sources: what
the wheel lacks is missing there. Leaves the wheel in dist/.
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS = ROOT / "constraints.txt"
PHOTO = "from skimage import data; from PIL import Image; Image.fromarray(data.astronaut())"
NOTHING_FOR_RESEARCH_ONLY = (  # dlib's landmark model is an extra
    "from importlib.util import find_spec as f; "
    "assert not f('dlib') and not f('face_recognition_models')"
)
PATIENCE_S = 180.0  # torch is read from the disk for the first time, perhaps with others at work
# both run the same code on one machine: only the order of sums by threads may differ
TOLERANCE = 1e-4


def main() -> int:
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="skylight-wheel-") as folder:
        home = Path(folder)
        wheel = build(home)
        run(sys.executable, "-m", "venv", "empty", cwd=home)
        bin_ = home / "empty" / "bin"
        pip = bin_ / "python", "-m", "pip", "--disable-pip-version-check"
        run(*pip, "uninstall", "-q", "-y", "setuptools", cwd=home)  # some venvs have it, some not
        run(*pip, "install", "-q", "-c", CONSTRAINTS, home / "sources" / "relight", cwd=home)
        say(started, f"relighting alone installed: {megabytes(home / 'empty')} MB")
        relight(bin_ / "skylight", home)
        say(started, "it relights as the tree does")
        run(*pip, "install", "-q", "-c", CONSTRAINTS, f"{wheel}[studio]", cwd=home)
        say(started, f"the full package installed over it: {megabytes(home / 'empty')} MB")
        run(bin_ / "python", "-c", NOTHING_FOR_RESEARCH_ONLY, cwd=home)
        run(bin_ / "python", "-c", f"{PHOTO}.save('photo.png')", cwd=home)
        run(bin_ / "skylight", "--version", cwd=home)
        estimate(bin_ / "skylight", home, "from_wheel")
        estimate(Path(sys.executable).with_name("skylight"), home, "from_tree")
        difference = compare(home / "from_wheel", home / "from_tree")
        say(started, f"an estimate; the wheel's and the tree's differ by {difference:.1g}")
        run(bin_ / "skylight", "convert", "from_wheel/probe.exr", "blender.hdr",
            "--convention", "blender", cwd=home)  # fmt: skip
        run(bin_ / "skylight", "export", "viewer", "from_wheel", "--out", "page.html", cwd=home)
        studio(bin_ / "skylight", home)
        say(started, "the studio answers")
        (ROOT / "dist").mkdir(exist_ok=True)
        shutil.copy(wheel, ROOT / "dist")
    return 0


def build(home: Path) -> Path:
    """The wheel, built from a copy of the sources so that the tree stays as it is."""
    sources = home / "sources"
    names = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True,
    ).stdout.decode().split("\0")  # fmt: skip
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (sources / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, sources / name)
    run(sys.executable, "-m", "build", "--wheel", "--outdir", home, sources, cwd=home, quiet=True)
    (wheel,) = home.glob("*.whl")
    return wheel


def relight(alone: Path, home: Path) -> None:
    """Light a ball by a latent sky, here without torch and by the tree: the same picture."""
    full = Path(sys.executable).with_name("skylight")
    ball = "import trimesh; trimesh.creation.icosphere(subdivisions=3).export('ball.obj')"
    run(sys.executable, "-c", ball, cwd=home)
    run(full, "export", "scene", "ball.obj", "--out", "ball.npz", "--height", "96", cwd=home)
    (home / "latent.json").write_text(json.dumps([0.1] * 64))
    for skylight, out in ((alone, "alone.png"), (full, "full.png")):
        run(skylight, "relight", "ball.npz", "--latent", "latent.json", "--out", out, cwd=home)
    program = "import numpy, PIL.Image as i; a, b = (numpy.int16(i.open(f'{n}.png')) for n in " \
        "('alone', 'full')); assert a.std() > 10 and abs(a - b).max() <= 1"  # fmt: skip
    run(alone.with_name("python"), "-c", program, cwd=home)
    other = subprocess.run(
        [alone, "estimate", "photo.png"], cwd=home, capture_output=True, text=True
    )
    if other.returncode != 2 or "the full package" not in other.stderr:
        raise SystemExit(f"relighting alone answers `estimate` by\n{other.stdout}{other.stderr}")


def megabytes(environment: Path) -> int:
    """Size of its packages on disk."""
    (packages,) = environment.glob("lib/*/site-packages")
    return round(sum(f.stat().st_size for f in packages.rglob("*") if f.is_file()) / 1e6)


def estimate(skylight: Path, home: Path, out: str) -> None:
    run(skylight, "estimate", "photo.png", "--light", "sunsky", "--out", out, cwd=home, quiet=True)


def compare(first: Path, second: Path) -> float:
    """Largest difference of the parameters, over 1 or their size where that is more."""
    one, other = (
        json.loads((folder / "estimate.json").read_text())["params"] for folder in (first, second)
    )
    worst = max(abs(a - b) / max(abs(b), 1.0) for a, b in zip(one, other, strict=True))
    if not worst <= TOLERANCE:
        raise SystemExit(f"the wheel's estimate differs from the tree's by {worst:.2g}")
    return worst


def studio(skylight: Path, home: Path) -> None:
    """Start the studio, and fetch its page and what it says of itself."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    server = subprocess.Popen([skylight, "studio", "--no-browser", "--port", str(port)], cwd=home)
    try:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                page = urllib.request.urlopen(f"{address}/", timeout=5).read().decode()
                break
            except OSError:
                if server.poll() is not None or time.monotonic() > deadline:
                    raise SystemExit("the wheel's studio did not start") from None
                time.sleep(0.2)
        if "skylight studio" not in page:
            raise SystemExit("the wheel's studio has no page")
        urllib.request.urlopen(f"{address}/assets/index.js", timeout=PATIENCE_S).read()
        about = json.load(urllib.request.urlopen(f"{address}/api/about", timeout=PATIENCE_S))
        print(f"studio {about['version']}")
    finally:
        server.terminate()
        server.wait(timeout=20)


def run(*command: object, cwd: Path, quiet: bool = False) -> None:
    """Run it away from the tree's modules; what it prints is shown where it fails."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        shown = " ".join(map(str, command))
        raise SystemExit(f"{shown}\n{done.stdout}{done.stderr}\nended with {done.returncode}")
    if not quiet:
        print(done.stdout, end="")


def say(started: float, what: str) -> None:
    print(f"{time.monotonic() - started:4.0f} s  {what}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
