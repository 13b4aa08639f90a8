import subprocess
import sys
from pathlib import Path

import pytest

from skylight.training._run import main

ROOT = Path(__file__).parents[2]


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that ``train.py`` says before it exits with 2."""
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return said


@pytest.fixture
def run_yaml(tmp_path: Path) -> str:
    path = tmp_path / "run.yaml"
    path.write_text(f"kind: autoencoder\ndata: {tmp_path}/none\nout: {tmp_path}/out\n")
    return str(path)


@pytest.mark.parametrize("arguments", [(), ("--epochs", "3")])
def test_usage(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    assert refused(capsys, *arguments).startswith("train.py: usage: python train.py")


def test_one_line_for_what_cannot_be_read(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, run_yaml: str
) -> None:
    assert "none.yaml" in refused(capsys, str(tmp_path / "none.yaml"))
    no_skies = refused(capsys, run_yaml)
    assert "no index of skies there" in no_skies
    assert no_skies.count("\n") == 1
    assert "`batch` must be at least 1" in refused(capsys, run_yaml, "--batch", "0")


@pytest.mark.parametrize(
    "override", [("--epoch", "3"), ("--epochs", "many"), ("--coding", "gamma"), ("--epochs",)]
)
def test_overrides_are_checked(
    capsys: pytest.CaptureFixture[str], run_yaml: str, override: tuple[str, ...]
) -> None:
    assert override[0] in refused(capsys, run_yaml, *override)


def test_an_interrupted_run_says_how_to_go_on(
    capsys: pytest.CaptureFixture[str], run_yaml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("skylight.training._run.train", interrupted)
    with pytest.raises(SystemExit) as caught:
        main([run_yaml])
    assert caught.value.code == 1
    assert "goes on from here" in capsys.readouterr().err


def test_an_output_folder_that_cannot_be(
    capsys: pytest.CaptureFixture[str], run_yaml: str, sky_folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "out").write_text("a file stands in the way")
    with pytest.raises(SystemExit) as caught:
        main([run_yaml, "--data", str(sky_folder)])
    assert caught.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith("train.py: ")
    assert said.count("\n") == 1


def test_the_script() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "train.py")], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 2
    assert done.stderr.startswith("train.py: usage")
