"""From a folder with forty skies to a model, an estimate with it and a decoder of it."""

import json
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from PIL import Image
from skimage.data import astronaut

from skylight.cli import main
from skylight.io._files import read_environment_map
from skylight.relight._decoder import SkyDecoder

LATENTS = 64


@pytest.mark.slow
def test_three_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["skies", "simulate", "--days", "5", "--out", "simulated"]) == 0
    skies = sorted(Path("simulated").glob("*.exr"))[:40]
    assert len(skies) == 40
    Path("skies").mkdir()
    for sky in skies:
        sky.rename(Path("skies") / sky.name)
    Image.fromarray(astronaut()[:256, 100:356]).save("portrait.png")

    assert main(["train", "skies", "--out", "model", "--epochs", "1"]) == 0
    model = ["--light", "autoencoder", "--model", "model"]
    assert main(["estimate", "portrait.png", *model, "--out", "light"]) == 0
    assert main(["export", "decoder", "--model", "model", "--out", "sky.onnx"]) == 0

    latents = np.float32([json.loads(Path("light/estimate.json").read_text())["params"][:LATENTS]])
    probe = read_environment_map(Path("light/probe.exr")).resize(64).radiance[:32].numpy()
    own = disagreement(SkyDecoder("sky.onnx").decode(latents)[0], probe)
    assert own < 0.01
    assert disagreement(SkyDecoder().decode(latents)[0], probe) > 3 * own


def disagreement(sky: Float[np.ndarray, "h w 3"], probe: Float[np.ndarray, "h w 3"]) -> float:
    """Mean relative difference of the rows' medians, without what a turn, an exposure or the
    blur of the sun changes."""
    a, b = (np.median(each, axis=(1, 2)) for each in (sky, probe))
    return float(np.abs(a / a.mean() - b / b.mean()).mean())
