"""Voxel probes at run time: a lightmap completed, and frames of 640 x 480 from start to end."""

import numpy as np
import pytest
import torch

from skylight.app.probes.voxel.render import VoxelPlacement
from skylight.cameras.response import Response
from skylight.probes.voxel.interreflection.global_illumination import GlobalReconstruction
from skylight.probes.voxel.model import VoxelModel
from skylight.probes.voxel.printed.assembly import PlacedProbe
from skylight.probes.voxel.reconstruct import DirectReconstruction
from skylight.probes.voxel.relight.live import STAGES, LiveView
from tests.app.probes.voxel.test_use import BOARD, LENS, VIEWS, light, photograph, standing


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


def test_live_frame(benchmark) -> None:
    """Track, capture, complete and draw a model of 2,000 voxels."""
    generator = np.random.default_rng(0)
    solid = generator.random((20, 20, 20)) < 0.25
    model = VoxelModel(occupied=solid)
    view = LiveView(
        intrinsics=LENS,
        board=BOARD,
        response=Response(),
        probe=PlacedProbe(standing()),
        model=model,
        to_board=VoxelPlacement(x_mm=60.0, z_mm=75.0, voxel_mm=5.0).matrix(model),
        reconstruction=lambda lightmap: DirectReconstruction(lightmap.known),
    )
    photos = [photograph(number) for number in range(len(VIEWS))]
    # by now all sides have been seen; frames without a board cost next to nothing
    frames = [photo for photo in photos if view.show(photo).tracked]
    turn = iter(range(1_000_000))
    shown = benchmark(lambda: view.show(frames[next(turn) % len(frames)]))
    assert shown.tracked
    for stage in STAGES:
        benchmark.extra_info[f"{stage}_ms"] = 1000 * shown.seconds.get(stage, 0.0)
