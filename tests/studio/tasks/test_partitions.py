"""Sizes at which the named designs can be printed."""

import pytest

from skylight.errors import InputError
from skylight.fabrication.mount import Pole
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design.designs import design_names, named_design
from skylight.probes.partitions.printed.halves import probe_parts, standing_rotation
from skylight.studio.tasks.partitions import size_of, sizes_for

SLOW = {"110d"}  # seconds for its shell


@pytest.mark.parametrize("design", [name for name in design_names() if name not in SLOW])
def test_the_size_of_a_design_can_be_printed_and_little_less_cannot(design: str) -> None:
    cells = Cells.of(named_design(design))
    turn, pole_mm = standing_rotation(cells), Pole().diameter_mm
    size = size_of(design)
    assert probe_parts(cells, sizes_for(size), rotation=turn, pole_mm=pole_mm).parts
    if size > 80:
        with pytest.raises(InputError, match=r"narrow|cut in two"):
            probe_parts(cells, sizes_for(size - 20), rotation=turn, pole_mm=pole_mm)
