"""Sizes of the named designs."""

import pytest

from skylight.probes.fabrication._mount import Pole
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions.printed._assembly import AskedSizes, fitted_sizes
from skylight.studio.tasks._probes import size_of

# the others take seconds each
QUICK = {"6d", "14d-outdoor"}


@pytest.mark.parametrize(
    "design",
    [
        name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)
        for name in design_names()
    ],
)
def test_the_size_that_is_told_is_the_one_that_is_printed(design: str) -> None:
    cells = Cells.of(named_design(design))
    sizes = fitted_sizes(cells, AskedSizes(), pole_mm=Pole().diameter_mm)
    assert size_of(design) == sizes.outer_mm
