"""An HDR probe merged from exposures of a lat-long picture: all of its files, or none."""

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from skylight.imaging._colour import linear_to_srgb

TIMES = (1 / 64, 1 / 16, 1 / 4)


def command(folder: Path) -> list[str]:
    """What to run in ``folder``, and again after a kill; makes the pictures if there are none."""
    folder.mkdir(parents=True, exist_ok=True)
    shots = [folder / f"shot{number}.png" for number in range(len(TIMES))]
    if not shots[-1].exists():
        draw = np.random.default_rng(0)
        row, column = np.mgrid[0:128, 0:256]
        light = 2 + np.sin(column[..., None] / (7, 9, 11)) + np.cos(row[..., None] / (5, 6, 8))
        for shot, time in zip(shots, TIMES, strict=True):
            shown = torch.from_numpy(np.clip(2 * light * time, 0, 1))
            codes = 255 * linear_to_srgb(shown).numpy() + 0.5 * draw.standard_normal(light.shape)
            Image.fromarray(np.rint(codes.clip(0, 255)).astype(np.uint8)).save(shot)
    times = ",".join(str(time) for time in TIMES)
    options = ["--kind", "360", "--height", "64", "--times", times, "--out", str(folder / "out")]
    shown = [str(shot) for shot in shots]
    return [sys.executable, "-m", "skylight", "probe", "merge", *shown, *options]


def result(folder: Path) -> dict[str, str]:
    """The files that there are, bit by bit; what was measured, but for the paths in it."""
    out = folder / "out"
    if not out.exists():
        return {}
    return {path.name: _content(path, folder) for path in sorted(out.glob("probe.*"))}


def is_consistent(found: dict[str, str], expected: dict[str, str]) -> bool:
    """Whether a kill left nothing but complete files of the result."""
    return found.items() <= expected.items()


def _content(path: Path, folder: Path) -> str:
    if path.suffix == ".json":
        told = json.loads(path.read_text(encoding="utf-8").replace(str(folder), "FOLDER"))
        told.pop("seconds", None)
        return json.dumps(told, sort_keys=True)
    return hashlib.sha256(path.read_bytes()).hexdigest()
