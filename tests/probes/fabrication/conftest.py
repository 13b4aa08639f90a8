"""The 3-probe at 20 / 1.6 / 0.15 mm, with its foot and base."""

import pytest

from skylight.probes.fabrication._mount import MarkerBoard, Mount, Pole, make_mount
from skylight.probes.fabrication._parts import PrintSizes
from skylight.probes.voxel._model import star_probe
from skylight.probes.voxel._parts import VoxelParts, voxel_parts


@pytest.fixture(scope="session")
def cross() -> VoxelParts:
    return voxel_parts(star_probe(3), PrintSizes())


@pytest.fixture(scope="session")
def mount(cross: VoxelParts) -> Mount:
    return make_mount(cross.mount_lattice, cross.mount_collar, cross.sizes, Pole(), MarkerBoard())
