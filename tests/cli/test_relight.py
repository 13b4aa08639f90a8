"""`skylight relight` from end to end."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skylight.cli import main
from skylight.relight import _command as command
from tests.cli.test_cli import one_line, written_exr


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


def test_where_torch_and_tyro_are_missing(scene: Path, tmp_path: Path) -> None:
    """The command without the full package: the same picture, and one line for other commands."""
    probe = tmp_path / "probe.exr"
    written_exr(5.0)(probe)
    light = ["--probe", str(probe), "--azimuth", "30", "--ground-albedo", "0.4"]
    assert main(["relight", str(scene), "--out", str(tmp_path / "full.png"), *light]) == 0
    program = (
        "import sys; sys.modules.update(dict.fromkeys(('torch', 'tyro')))\n"
        "from skylight.__main__ import main; sys.exit(main())"
    )
    alone = [sys.executable, "-c", program]
    out = tmp_path / "alone.png"
    subprocess.run([*alone, "relight", str(scene), "--out", str(out), *light], check=True)
    assert out.read_bytes() == (tmp_path / "full.png").read_bytes()
    failed = subprocess.run([*alone, "estimate", "a.png"], capture_output=True, text=True)
    assert failed.returncode == 2
    (line,) = failed.stderr.splitlines()
    assert "`estimate`" in line
    assert "pip install" in line


def test_without_tyro_errors_are_one_line_too(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["relight", str(scene), "--out", str(tmp_path / "lit.png"), "--probe", "gone.exr"]
    assert command.main(arguments) == 2
    assert "gone.exr" in one_line(capsys)


@pytest.mark.parametrize("first", [True, False])
def test_debug_goes_before_or_after_the_command(
    first: bool, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["relight", str(scene), "--out", str(tmp_path / "lit.png"), "--probe", "gone.exr"]
    debug = ["--debug"]
    given = debug + arguments if first else arguments + debug
    told = []
    for run in (command.main, main):
        assert run(given) == 2
        told.append(capsys.readouterr().err.splitlines())
    assert told[0][-1] == told[1][-1]
    assert {lines[0] for lines in told} == {"Traceback (most recent call last):"}
