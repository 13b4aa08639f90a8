"""Sizes of printed parts, and their places on the bed."""

import re
from itertools import combinations

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.fabrication._parts import PrintSizes, box, lay_out, part_of
from skylight.probes.voxel._parts import VoxelParts


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


def test_parts_lie_on_the_bed_apart_from_one_another(cross: VoxelParts) -> None:
    bed = lay_out(cross.parts, spacing_mm=2.5)
    bounds = [part.bounds for part in bed.parts]
    for low, high in bounds:
        assert low[2] == pytest.approx(0)
        assert (low > -1e-9).all()
        assert (high < np.array(bed.size_mm) + 1e-9).all()
    for (low, high), (other_low, other_high) in combinations(bounds, 2):
        gap = np.maximum(low - other_high, other_low - high)[:2].max()
        assert gap >= 2.5 - 1e-9


def test_parts_stand_upright_and_keep_their_shape(cross: VoxelParts) -> None:
    for part, placed in zip(cross.parts, lay_out(cross.parts).parts, strict=True):
        assert placed.up == (0, 0, 1)
        assert placed.volume_mm3 == pytest.approx(part.volume_mm3)  # no mirror image


def test_smaller_than_a_row_or_a_column(cross: VoxelParts) -> None:
    bed = lay_out(cross.parts, spacing_mm=3.0)
    sizes = np.array([np.ptp(part.bounds, axis=0) for part in bed.parts])
    row = (sizes[:, 0].sum() + 18) * sizes[:, 1].max() * sizes[:, 2].max()
    assert bed.volume_mm3 < row
    # and mostly parts
    assert (sizes[:, 0] * sizes[:, 1]).sum() > 0.6 * bed.size_mm[0] * bed.size_mm[1]


def test_equal_squares_make_a_square() -> None:
    cubes = [part_of(f"{i}", box(np.zeros(3), np.full(3, 10.0))) for i in range(9)]
    assert lay_out(cubes, spacing_mm=1.0).size_mm == pytest.approx((32, 32, 10))


def test_long_parts_lie_along_x() -> None:
    long = part_of("long", box(np.zeros(3), np.array([2.0, 30, 5])))
    assert lay_out([long]).size_mm == pytest.approx((30, 2, 5))


def test_nothing_or_negative_spacing_is_refused(cross: VoxelParts) -> None:
    with pytest.raises(InputError, match="no part"):
        lay_out([])
    with pytest.raises(InputError, match="spacing_mm"):
        lay_out(cross.parts, spacing_mm=-1.0)
