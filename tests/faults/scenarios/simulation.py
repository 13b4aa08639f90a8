"""Days of skies, simulated by two processes."""

import hashlib
import sys
from pathlib import Path

DAYS = 6


def command(folder: Path) -> list[str]:
    """What to run in ``folder``, and again after a kill."""
    folder.mkdir(parents=True, exist_ok=True)
    size = ["--days", str(DAYS), "--size", "8x32", "--interval", "120", "--workers", "2"]
    out = ["--out", str(folder / "out")]
    return [sys.executable, "-m", "skylight", "skies", "simulate", *size, *out]


def result(folder: Path) -> dict[str, str]:
    """Every map and every part of the index, bit by bit; not what a kill left half written."""
    out = folder / "out"
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and not path.name.startswith(".partial-")
    }
