"""``skylight train`` refuses what it cannot do in a line."""

from pathlib import Path

import pytest

from skylight.cli import main
from tests.cli.test_cli import one_line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere", "--out", "out"], "no such folder"),
        (["empty", "--out", "out"], "no .exr or .hdr maps"),
        (["empty"], "--out is missing"),
        (["empty", "--out", "out", "--config", "sky_prior"], "trains no light model"),
        (["empty", "--out", "out", "--config", "moon"], "choose one of csc_dictionary, sky_auto"),
        (["empty", "--out", "out", "--config", "a.yaml"], "a.yaml"),
        (["--config", "sky_prior"], "no index of skies there"),
        (["--config", "sky_prior", "--epochs", "2"], "leave --epochs out"),
        (["--config", "csc_dictionary", "--device", "cpu"], "leave --device out"),
        (["--config", "sky_prior", "bank=3"], "`bank` must be at least 24"),
        (["--config", "sky_autoencoder", "epoch=2"], "did you mean epochs?"),
        (["epochs=2"], "no index of skies there"),
        (["epochs=2", "--epochs", "3"], "epochs= and --epochs are both given"),
        (["empty", "epochs=two", "--out", "out"], "a whole number at least 1, got 'two'"),
        (["empty", "data=other", "--out", "out"], "data= and FOLDER empty are both given"),
        (["empty", "out=out", "--epochs", "3"], "no .exr or .hdr maps"),
        (["epochs=3", "empty", "--out", "out"], "no .exr or .hdr maps"),
        (["empty", "other", "--out", "out"], "give one FOLDER, not empty and other"),
    ],
)
def test_refusals(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    assert main(["train", *arguments]) == 2
    assert said in one_line(capsys)


def test_keys(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--config", "sky_prior", "--keys"]) == 0
    assert "  most_components=16 " in capsys.readouterr().out
