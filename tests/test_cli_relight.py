"""`skylight relight` from end to end."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skylight.cli import main
from tests.test_cli import one_line, written_exr


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import trimesh

    folder = tmp_path_factory.mktemp("scene")
    trimesh.creation.icosphere(subdivisions=2).export(folder / "ball.obj")
    out = folder / "ball.npz"
    arguments = [str(folder / "ball.obj"), "--out", str(out), "--height", "24"]
    assert main(["export", "scene", *arguments]) == 0
    return out


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_probe_with_impossible_radiance(
    value: float, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    probe, out = tmp_path / "probe.exr", tmp_path / "lit.png"
    written_exr(value)(probe)
    out.write_bytes(b"earlier picture")
    assert main(["relight", str(scene), "--out", str(out), "--probe", str(probe)]) == 2
    assert "probe.exr" in one_line(capsys)
    assert out.read_bytes() == b"earlier picture"


def test_damaged_decoder(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "z.json").write_text(json.dumps([0.0] * 64))
    (tmp_path / "decoder.onnx").write_bytes(b"no graph")
    light = ["--latent", str(tmp_path / "z.json"), "--decoder", str(tmp_path / "decoder.onnx")]
    assert main(["relight", str(scene), "--out", str(tmp_path / "lit.png"), *light]) == 1
    assert "decoder.onnx" in one_line(capsys)
    assert not (tmp_path / "lit.png").exists()


def test_needs_no_torch(scene: Path, tmp_path: Path) -> None:
    probe, out = tmp_path / "probe.exr", tmp_path / "lit.png"
    written_exr(5.0)(probe)
    program = (
        "import sys, skylight; from skylight.cli import main\n"
        f"code = main(['relight', {str(scene)!r}, '--out', {str(out)!r}, "
        f"'--probe', {str(probe)!r}])\n"
        "sys.exit(code or int('torch' in sys.modules))"
    )
    subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)
    with Image.open(out) as picture:
        assert picture.size == (32, 24)
