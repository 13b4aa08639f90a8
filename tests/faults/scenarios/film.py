"""The light of a film of one person."""

import hashlib
import json
import sys
from pathlib import Path

from skimage.data import astronaut

from tests.films import write_film

FRAMES, KEYFRAMES = 6, 3


def command(folder: Path) -> list[str]:
    """What to run in ``folder``, and again after a kill; makes the film where there is none."""
    film = folder / "film.mp4"
    if not film.exists():
        folder.mkdir(parents=True)
        write_film(film, [astronaut()[:320, left : left + 320] for left in range(60, 60 + FRAMES)])
    arguments = ["estimate", str(film), "--video", "--out", str(folder / "out")]
    options = ["--keyframes", str(KEYFRAMES), "--light", "sunsky"]
    return [sys.executable, "-m", "skylight", *arguments, *options]


def result(folder: Path) -> dict[str, str]:
    """Every file of the light and of what was followed, bit by bit; numbers but for the paths."""
    out = folder / "out"
    return {
        str(path.relative_to(out)): _content(path, folder)
        for path in sorted(out.rglob("*"))
        if path.is_file() and not any(part[0] == "." for part in path.relative_to(out).parts)
    }


def _content(path: Path, folder: Path) -> str:
    if path.suffix == ".json":
        told = json.loads(path.read_text(encoding="utf-8").replace(str(folder), "FOLDER"))
        return json.dumps(told, sort_keys=True)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def is_consistent(found: dict[str, str], expected: dict[str, str]) -> bool:
    """Whether a kill left nothing but complete files of the result."""
    return found.items() <= expected.items()
