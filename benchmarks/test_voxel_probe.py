"""Voxel probes at run time: a lightmap completed."""

import pytest
import torch

from skylight.probes.voxel._interreflection import GlobalReconstruction
from skylight.probes.voxel._reconstruct import DirectReconstruction
from tests.probes.voxel.test_use import light


@pytest.fixture(scope="module")
def known() -> torch.Tensor:
    mask = torch.zeros(6, 32, dtype=torch.bool)
    mask[:, [0, 1, 2, 4, 8]] = True
    return mask


@pytest.mark.parametrize("kind", ["direct", "global"])
def test_complete(benchmark, known: torch.Tensor, kind: str) -> None:
    """All 192 slots of 16 x 16 texels in three colours."""
    module = DirectReconstruction(known) if kind == "direct" else GlobalReconstruction(known)
    radiance = light().radiance
    benchmark(module, radiance)
