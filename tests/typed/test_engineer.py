"""The script that ``make lint`` checks the types of runs, but for what asks for files."""

from pathlib import Path

import pytest
import torch

from skylight.models import SunSky
from skylight.sphere import EnvironmentMap
from skylight.transport import DiffuseTransport
from tests.typed import engineer


@pytest.mark.slow
def test_what_an_engineer_writes_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    sky = SunSky(16)
    radiance = sky(sky.starts()[0]).detach().reshape(16, 64, 3)
    environment = EnvironmentMap(radiance=torch.cat([radiance, 0.1 * radiance]))
    assert engineer.likely_light(environment).shape == (32 * 128, 3)
    assert (tmp_path / "decoder.onnx").stat().st_size > 1e5

    assert engineer.coded(environment.radiance).shape == (32, 64, 3)
    assert engineer.through_probe(environment).shape == (32 * 64, 3)
    harmonic = engineer.skylight.HarmonicLight(2, 16)
    mesh = torch.ones(20, 512, dtype=torch.bool), torch.randn(20, 3)
    seen = DiffuseTransport(*mesh, harmonic.grid)(harmonic(harmonic.starts()[:1]) + 0.2)
    assert engineer.fitted(harmonic, mesh, 0.5 * seen.detach()).shape == (1, 27)
