"""An estimate as one web page: all of it, or none."""

import atexit
import hashlib
import sys
import tempfile
from functools import cache
from pathlib import Path

from tests.estimated import estimated


def command(folder: Path) -> list[str]:
    """What to run in ``folder``, and again after a kill; the estimate is made once for all."""
    folder.mkdir(parents=True, exist_ok=True)
    photo, results = _estimate()
    arguments = ["export", "viewer", str(results), "--out", str(folder / "page.html")]
    return [sys.executable, "-m", "skylight", *arguments, "--photo", str(photo)]


def result(folder: Path) -> dict[str, str]:
    """The page, bit by bit, where it is there."""
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.glob("*")
        if path.name[0] != "."
    }


def is_consistent(found: dict[str, str], expected: dict[str, str]) -> bool:
    """Whether a kill left the whole page or none."""
    return found.items() <= expected.items()


@cache
def _estimate() -> tuple[Path, Path]:
    folder = tempfile.TemporaryDirectory(prefix="skylight-estimated-")
    atexit.register(folder.cleanup)
    return estimated(Path(folder.name))
