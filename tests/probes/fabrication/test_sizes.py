import re

import pytest

from skylight.errors import InputError
from skylight.probes.fabrication._parts import PrintSizes


@pytest.mark.parametrize("name", ["face_mm", "wall_mm", "clearance_mm"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_lengths_are_above_zero(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        PrintSizes(**{name: value})


def test_a_gap_as_wide_as_the_wall_holds_nothing() -> None:
    with pytest.raises(InputError, match=r"clearance_mm 1\.6 must be below wall_mm 1\.6"):
        PrintSizes(wall_mm=1.6, clearance_mm=1.6)


def test_walls_that_fill_the_face_are_refused_with_the_face_that_would_do() -> None:
    with pytest.raises(InputError) as caught:
        PrintSizes(face_mm=8.0, wall_mm=1.6, clearance_mm=0.15)
    least = float(re.search(r"make the face ([\d.]+) mm", str(caught.value)).group(1))
    PrintSizes(face_mm=least, wall_mm=1.6, clearance_mm=0.15)
