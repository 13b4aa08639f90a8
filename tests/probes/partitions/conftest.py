"""What several tests of the partitions probe use, made once."""

from collections.abc import Iterator

import pytest

from skylight.probes.partitions import _relight_files
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.printed._assembly import AskedSizes
from skylight.probes.partitions.printed._printing import PrintedPartitions, print_fitted
from skylight.probes.partitions.relight import _composite, _gather


@pytest.fixture(scope="session")
def printed_cube() -> PrintedPartitions:
    """Six cells by default: 80 mm across, faces 4 mm from the centre, flared walls of 1.6 mm."""
    return print_fitted(named_design("6d"), AskedSizes())


@pytest.fixture(scope="module")
def coarse_ground() -> Iterator[None]:
    """A quarter of the ground's vertices, and one ray through each pixel of a photo."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (_gather, _composite):
            patch.setattr(module, "ACROSS", 49)
        patch.setattr(_relight_files, "_SAMPLES", 1)
        yield
