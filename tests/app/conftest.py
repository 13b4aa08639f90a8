"""What the tests of commands share."""

from pathlib import Path

import pytest
import torch

from skylight.io.files import write_environment_map
from skylight.sphere.envmap import EnvironmentMap


@pytest.fixture
def probe(tmp_path: Path) -> Path:
    """A map of 16 rows with a sun of 500 in row 4, column 20."""
    radiance = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    radiance[4, 20] = 500.0
    write_environment_map(tmp_path / "probe.exr", EnvironmentMap(radiance=radiance))
    return tmp_path / "probe.exr"
