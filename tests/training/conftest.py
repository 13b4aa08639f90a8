from pathlib import Path

import pytest

from skylight.skies._simulated import simulate_folder


@pytest.fixture(scope="session")
def sky_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six days in miniature: four to train on, one to validate, one to test."""
    out = tmp_path_factory.mktemp("skies")
    simulate_folder(out, days=6, first_seed=13, interval_min=180.0, height=8)
    return out


@pytest.fixture(autouse=True)
def one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starting other processes takes seconds, and these skies are few."""
    monkeypatch.setattr("skylight.training._skies.cores", lambda: 1)
