"""A portrait relit: its picture whole, or none."""

import sys
from pathlib import Path

from PIL import Image
from skimage.data import astronaut

from tests.faults.scenarios.viewer import is_consistent, result

__all__ = ["command", "is_consistent", "result"]


def command(folder: Path) -> list[str]:
    """What to run in ``folder``, and again after a kill; makes the photograph if there is none."""
    folder.mkdir(parents=True, exist_ok=True)
    photo = folder / "photo.png"
    if not photo.exists():
        Image.fromarray(astronaut()[:256, 100:356]).save(photo)
    arguments = ["relight-portrait", str(photo), "--turn", "60", "--light", "sh9"]
    return [sys.executable, "-m", "skylight", *arguments, "--out", str(folder / "relit.png")]
