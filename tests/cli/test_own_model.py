"""From a folder with forty skies to a model, an estimate with it and a decoder of it."""

import json
import shutil
import subprocess
import sys
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
EXAMPLES = Path(__file__).parents[2] / "examples"


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


@pytest.mark.slow
def test_a_network_of_ones_own_from_skies_to_a_report(tmp_path: Path) -> None:
    """By commands in its folder, as a user types them."""

    def skylight(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "skylight", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=400)

    for name in ("own_network.py", "own_network.yaml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    Image.fromarray(astronaut()[:256, 100:356]).save(tmp_path / "portrait.png")
    assert skylight("skies", "simulate", "--days", "6", "--out", "runs/skies").returncode == 0
    made = skylight("train", "--config", "own_network.yaml", "--epochs", "1")
    assert made.returncode == 0, made.stderr

    estimate = ["estimate", "portrait.png", "--model", "runs/own_network", "--out", "light"]
    place = "own_network:PixelNetwork"
    for network, said in (
        ([], f"give --network {place}"),
        (["--network", "tests.own_network:TinyNetwork"], "not tests.own_network:TinyNetwork"),
    ):
        refused = skylight(*estimate, *network)
        assert refused.returncode == 2
        line = refused.stderr.strip().splitlines()[-1]
        assert line.startswith(f"skylight: runs/own_network: its network is {place}")
        assert said in line
    found = skylight(*estimate, "--network", place)
    assert found.returncode == 0, found.stderr
    assert (tmp_path / "light/report.png").is_file()

    (tmp_path / "folder").mkdir()
    for name in ("a.png", "b.png"):
        shutil.copy(tmp_path / "portrait.png", tmp_path / "folder" / name)
    model = ["--model", "runs/own_network", "--network", place]
    workers = skylight("estimate", "folder", *model, "--workers", "2", "--out", "lights")
    assert workers.returncode == 0, workers.stderr
    decoder = skylight("export", "decoder", *model, "--out", "sky.onnx")
    assert decoder.returncode == 0, decoder.stderr
    params = json.loads((tmp_path / "light/estimate.json").read_text())["params"]
    latents = np.float32([params[:-1]])
    probe = read_environment_map(tmp_path / "light/probe.exr").resize(64).radiance[:32].numpy()
    decoded = SkyDecoder(str(tmp_path / "sky.onnx")).decode(latents)[0]
    # medians of its pixels, hardly trained, change with a turn; means of rows but the sun's do not
    ratio = decoded.mean((1, 2)) / probe.mean((1, 2))
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.01


def disagreement(sky: Float[np.ndarray, "h w 3"], probe: Float[np.ndarray, "h w 3"]) -> float:
    """Mean relative difference of the rows' medians, without what a turn, an exposure or the
    blur of the sun changes."""
    a, b = (np.median(each, axis=(1, 2)) for each in (sky, probe))
    return float(np.abs(a / a.mean() - b / b.mean()).mean())
