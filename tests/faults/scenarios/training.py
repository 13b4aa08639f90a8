"""A small autoencoder's training, a state after every step."""

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import torch

from skylight.io._files import write_environment_map
from skylight.io._tensors import read_tensors
from skylight.skies._index import INDEX_NAME, SkyRecord, write_rows
from skylight.sphere._envmap import EnvironmentMap
from skylight.training._config import AutoencoderConfig, config_yaml

ROOT = Path(__file__).parents[3]
SKIES, HEIGHT = 40, 8


def command(folder: Path) -> list[str]:
    """What to run in ``folder``, and again after a kill; makes the skies where there are none."""
    settings = folder / "run.yaml"
    if not settings.exists():
        folder.mkdir(parents=True, exist_ok=True)
        _make_skies(folder / "skies")
        config = AutoencoderConfig(
            data=folder / "skies",
            out=folder / "out",
            epochs=4,
            batch=8,
            warmup_steps=1,
            bfloat16=False,
            checkpoint_steps=1,
            threads=1,
        )
        settings.write_text(config_yaml(config), encoding="utf-8")
    return [sys.executable, str(ROOT / "train.py"), str(settings)]


def result(folder: Path) -> dict[str, str]:
    """Weights, momentum and curves; the speed, which differs, left out."""
    out = folder / "out"
    state, _ = read_tensors(out / "state.safetensors")
    digest = hashlib.sha256()
    for name, tensor in sorted(state.items()):
        digest.update(name.encode() + tensor.contiguous().numpy().tobytes())
    curves = json.loads((out / "curves.json").read_text(encoding="utf-8"))["curves"]
    rows = [{k: v for k, v in row.items() if k != "images_per_s"} for row in curves]
    model = (out / "model.safetensors").read_bytes()
    return {
        "model.safetensors": hashlib.sha256(model).hexdigest(),
        "state": digest.hexdigest(),
        "curves": json.dumps(rows),
    }


def _make_skies(folder: Path) -> None:
    folder.mkdir()
    draw = np.random.default_rng(0)
    records = []
    for number in range(SKIES):
        radiance = torch.from_numpy(draw.random((HEIGHT, 4 * HEIGHT, 3), dtype=np.float32))
        radiance[number % 5 + 1, 2 * HEIGHT] = 500.0
        write_environment_map(folder / f"{number}.exr", EnvironmentMap(radiance=radiance))
        records.append(
            SkyRecord(
                file=f"{number}.exr",
                day=str(number),
                time="",
                split="validation" if number % 5 == 0 else "train",
                regime="clear",
                sun_zenith_deg=90 * (number % 5 + 1.5) / HEIGHT,
                map_azimuth_deg=0.0,
                sun_transmittance=1.0,
            )
        )
    write_rows(folder / INDEX_NAME, records)
