"""A trained model of one's own: estimates with it, and refusals."""

import shutil
from importlib.resources import files
from pathlib import Path

import pytest
import torch
from PIL import Image
from skimage.data import astronaut

from skylight.cli import main
from skylight.evaluation._main import EVALUATIONS
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import estimate_light
from skylight.inverse._faces import Level
from skylight.inverse._sky import SolverOptions
from tests.evaluation.test_run import Counting
from tests.inverse.test_solve import SUNS, watched

FEW = SolverOptions(stages=(Stage(level=Level(3), starts=2, iterations=3),))


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A copy of the model that comes with skylight."""
    shipped = Path(str(files("skylight.models") / "data" / "sky_autoencoder"))
    return Path(shutil.copytree(shipped, tmp_path / "own"))


@pytest.mark.slow
@pytest.mark.parametrize("light", ["autoencoder", "sunsky"])
def test_a_copy_of_the_shipped_model_gives_the_same_light(own: Path, light: str) -> None:
    observation, _ = watched(*SUNS[0])
    found = estimate_light(observation, light, model=own, options=FEW)
    expected = estimate_light(observation, light, options=FEW)
    assert torch.equal(found.params, expected.params)
    assert torch.equal(found.environment.radiance, expected.environment.radiance)
    assert found.terms == expected.terms


@pytest.mark.parametrize("command", ["estimate", "evaluate"])
def test_a_damaged_model_is_one_line(
    own: Path, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (own / "network.safetensors").unlink()
    portrait = tmp_path / "me.png"
    Image.fromarray(astronaut()[:256, 100:356]).save(portrait)
    what = {"estimate": [str(portrait)], "evaluate": ["synthetic-faces", "--quick"]}[command]
    out = str(tmp_path / "out")
    assert main([command, *what, "--model", str(own), "--out", out]) == 2
    error = capsys.readouterr().err
    assert "network.safetensors is missing" in error
    assert "Traceback" not in error


def test_what_has_no_trained_model_refuses_one(
    own: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    portrait = tmp_path / "me.png"
    Image.fromarray(astronaut()[:256, 100:356]).save(portrait)
    model, out = ["--model", str(own)], ["--out", str(tmp_path / "out")]
    assert main(["estimate", str(portrait), "--light", "sh9", *model, *out]) == 2
    assert "leave --model out" in capsys.readouterr().err
    counting = Counting(count=1, marks=tmp_path / "marks")
    monkeypatch.setattr(Counting, "over", lambda data, quick: counting)
    monkeypatch.setitem(EVALUATIONS, "counting", Counting)
    assert main(["evaluate", "counting", *model, *out]) == 2
    assert "leave --model and --device out" in capsys.readouterr().err
    assert main(["evaluate", "sky-models", "--quick", "--device", "cpu", *out]) == 2
    assert "leave --device out" in capsys.readouterr().err
