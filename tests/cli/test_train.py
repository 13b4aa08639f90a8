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
