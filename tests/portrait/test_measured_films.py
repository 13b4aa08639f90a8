"""The tool that measures films relit."""

import sys
from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.work._resumable import SETTINGS, keep_settings
from tools import measure_relit_films


def test_films_of_another_run_are_not_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_settings(tmp_path / SETTINGS, {"frames": 6, "commit": "another"})
    elsewhere = [f"--{name}={tmp_path / name}" for name in ("out", "sheet")]
    arguments = ["measure", "--frames", "6", "--folder", str(tmp_path), *elsewhere]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(InputError, match="made with other settings"):
        measure_relit_films.main()
    assert [path.name for path in tmp_path.iterdir()] == [SETTINGS]
