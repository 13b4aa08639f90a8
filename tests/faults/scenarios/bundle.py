"""A light model from a folder of skies, by one command, which then loads as ``--model`` does."""

import hashlib
import sys
from pathlib import Path

from skylight.errors import InputError
from skylight.models._bundle import load_bundle
from skylight.training._config import AutoencoderConfig, config_yaml
from tests.drawn_skies import draw_skies

SKIES = 40
REFUSED = "refused"
_OF_PATHS = ("card.md", "report.json", "bundle.json")


def command(folder: Path) -> list[str]:
    """What to run in ``folder``, and again after a kill; makes the skies where there are none."""
    settings = folder / "run.yaml"
    if not settings.exists():
        (folder / "skies").mkdir(parents=True)
        draw_skies(folder / "skies", SKIES)
        config = AutoencoderConfig(batch=16, bfloat16=False, checkpoint_steps=1, threads=1)
        settings.write_text(config_yaml(config), encoding="utf-8")
    arguments = ["train", str(folder / "skies"), "--out", str(folder / "mine")]
    options = ["--config", str(settings), "--epochs", "2", "--device", "cpu"]
    return [sys.executable, "-m", "skylight", *arguments, *options]


def result(folder: Path) -> dict[str, str]:
    """What the model is by all its tensors, or that it is refused; every file of it, bit by bit.

    Not those that tell of the folder's own paths: card, report, and the manifest, whose hash of the
    data is of the index, which names maps elsewhere by their whole paths.
    """
    out = folder / "mine"
    found = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.glob("*"))
        if path.is_file() and path.name not in _OF_PATHS and path.name[0] != "."
    }
    try:
        found["model"] = load_bundle(out).fingerprint
    except InputError:
        found["model"] = REFUSED
    return found


def is_consistent(found: dict[str, str], expected: dict[str, str]) -> bool:
    """Whether a kill left the whole model or one that is refused."""
    return found["model"] in (REFUSED, expected["model"])
