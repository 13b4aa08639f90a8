"""Estimates of a folder of photos: some that go well (five), and two that do not."""

import hashlib
import json
import sys
from pathlib import Path

from PIL import Image
from skimage.data import astronaut


def command(folder: Path, faces: int = 5, workers: int = 2) -> list[str]:
    """What to run in ``folder``, and again after a kill; makes the photos where there are none."""
    photos = folder / "photos"
    if not photos.exists():
        photos.mkdir(parents=True)
        for shift in range(100, 100 + 10 * faces, 10):
            face = Image.fromarray(astronaut()[:256, shift : shift + 256])
            face.save(photos / f"face{shift}.png")
        Image.new("RGB", (64, 64), (200, 120, 40)).save(photos / "no_face.png")
        (photos / "damaged.jpg").write_bytes(b"nothing")
    arguments = ["estimate", str(photos), "--out", str(folder / "out"), "--light", "sh9"]
    return [sys.executable, "-m", "skylight", *arguments, "--workers", str(workers)]


def result(folder: Path) -> dict[str, str]:
    """All that must not depend on kills: every file and line, but for the seconds they took.

    report.png is only said to be there: it shows the seconds.
    """
    out = folder / "out"
    found = {
        str(path.relative_to(out)): _content(path)
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != "manifest.jsonl"
    }
    lines = (out / "manifest.jsonl").read_text(encoding="utf-8").splitlines()
    found["lines"] = str(len(lines))  # so that none is there twice
    for line in lines:
        entry = json.loads(line)
        del entry["seconds"]
        found[f"manifest {entry['source']}"] = json.dumps(entry, sort_keys=True)
    return found


def _content(path: Path) -> str:
    if path.name == "report.png":
        return "there"
    if path.name == "estimate.json":
        told = json.loads(path.read_text(encoding="utf-8"))
        del told["seconds"]
        return json.dumps(told, sort_keys=True)
    return hashlib.sha256(path.read_bytes()).hexdigest()
