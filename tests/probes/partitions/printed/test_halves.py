"""Parts as assembled: one piece each, cuts that come apart, and the pole's joint."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from skylight.errors import InputError
from skylight.probes.fabrication._parts import part_of
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions.printed._halves import (
    Foot,
    ProbeParts,
    ShellPlan,
    lowest_junction,
    probe_parts,
    standing_rotation,
)
from skylight.probes.partitions.printed._printing import PrintedPartitions, check_partition_parts
from skylight.probes.partitions.printed._solids import ProbeSizes, WallNet

SIZES = ProbeSizes(outer_mm=60.0, kernel_mm=9.0)


def parts_of(name: str, sizes: ProbeSizes = SIZES) -> ProbeParts:
    cells = Cells.of(named_design(name))
    return probe_parts(cells, sizes, rotation=standing_rotation(cells), pole_mm=6.0)


@pytest.fixture(scope="module")
def cube() -> ProbeParts:
    return parts_of("6d")


def test_a_cube_stands_on_its_corner() -> None:
    rotation = standing_rotation(Cells.of(named_design("6d")))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    # all six axes are as far from the vertical
    np.testing.assert_allclose(np.abs(rotation[1]), np.sqrt(1 / 3))
    # the least turn that does it
    assert np.trace(rotation) == pytest.approx(1 + 2 * np.sqrt(1 / 3))


def test_oriented_designs_are_not_turned() -> None:
    cells = Cells.of(named_design("14d-outdoor"))
    assert (standing_rotation(cells) == np.eye(3)).all()
    net = WallNet.of(cells)
    foot = Foot.of(net, SIZES, 6.0)
    # the pole stands below a junction, off the middle, and ends below the ball
    np.testing.assert_allclose(foot.axis, 30 * net.vertices[lowest_junction(net)][[0, 2]])
    x, z = foot.axis
    assert np.hypot(np.hypot(x, z) - foot.radius_mm, foot.top_mm) == pytest.approx(30)


def test_a_design_without_a_junction_below_is_refused() -> None:
    """Four cells, one of which looks straight down: its corners are 70 degrees from there."""
    seeds = torch.tensor([[0, -3.0, 0], [1, 1, 0], [-0.5, 1, 0.866], [-0.5, 1, -0.866]])
    seeds[1:, [0, 2]] *= 8**0.5
    design = ProbeDesign.of("tetrahedron", seeds, oriented=True)
    with pytest.raises(InputError, match="walls meet"):
        Foot.of(WallNet.of(Cells.of(design)), SIZES, 6.0)


def test_the_cube_splits_across_four_walls(cube: ProbeParts) -> None:
    """Along an axis of the cube, whose kernel then leaves no gap at all."""
    assert cube.split.cut.sum() == 4
    assert len(cube.split.pinned) == 4
    assert np.abs(cube.net.normals @ cube.split.way_in).max() == pytest.approx(1)
    assert cube.split.way_in @ cube.foot.joint < 0


def test_the_cubes_walls_weigh_what_they_should(cube: ProbeParts) -> None:
    """Twelve sectors less what lies above the kernel; pins, cuts and joints are small beside."""
    angle = np.arccos(1 / 3)
    sector = angle * 30**2 / 2
    edge = 9 * np.sqrt(2)  # from the centre to the middle of a cube's edge
    triangle = (edge + 0.15) ** 2 * np.tan(angle / 2)
    walls = 12 * 1.6 * (sector - triangle)
    bare = cube.lower.volume_mm3 + cube.upper.volume_mm3
    # socket: 18 mm at most of a tube, and eight bosses of 5.75 mm
    extra = np.pi * (4.75**2 * 18 + 8 * 2.75**2 * 5.75)
    assert walls * 0.97 < bare < walls + extra


def test_all_is_well_with_the_printed_cube(printed_cube: PrintedPartitions) -> None:
    report = printed_cube.report
    assert report.problems == ()
    assert report.thinnest_mm == pytest.approx(1.6, abs=1e-3)
    # 0.15 mm off planes at 45 degrees and more to the way the kernel moves
    assert min(report.kernel_play_mm) >= 0.15 - 1e-3
    np.testing.assert_allclose(report.pin_play_mm, 0.15, atol=2e-3)
    assert report.seam_mm == pytest.approx(0.15, abs=1e-3)


def test_reports_tell_what_is_wrong(cube: ProbeParts) -> None:
    """A kernel that is too large, and one half pushed into the other."""
    swollen = cube.kernel.solid()
    assert swollen is not None
    larger = part_of("kernel", swollen.scale((1.05, 1.05, 1.05)), (0, 1, 0))
    pushed = cube.upper.shifted(-0.5 * cube.split.way_in)
    broken = replace(cube, upper=pushed, kernel=larger)
    text = "; ".join(check_partition_parts(broken, SIZES).problems)
    assert "kernel in its shell: clearance 0.000" in text
    assert "upper half on the lower: clearance 0.000" in text
    assert "assembled parts share" in text
    assert "faces are up to 0.45 mm off" in text


@pytest.mark.slow
def test_an_outdoor_probe_can_be_printed() -> None:
    sizes = ProbeSizes(outer_mm=90.0, kernel_mm=13.0)
    report = check_partition_parts(parts_of("14d-outdoor", sizes), sizes)
    assert report.problems == ()


def test_shells_without_room_for_a_cut_are_refused() -> None:
    with pytest.raises(InputError, match="cut in two"):
        parts_of("14d", ProbeSizes(outer_mm=30.0, kernel_mm=8.0, wall_mm=2.4))


def test_halves_are_of_one_piece() -> None:
    """The plane with the smallest gaps alone would leave this upper half in three."""
    cells = Cells.of(named_design("6d-tilted-sun-12"))
    net = WallNet.of(cells, standing_rotation(cells))
    split = ShellPlan.of(net, ProbeSizes(outer_mm=130.0, kernel_mm=13.0, flare=1.0), 6.0).split
    kept, count = ~split.cut, len(net.vertices)
    links = coo_array((kept[kept], (net.starts[kept], net.ends[kept])), shape=(count, count))
    _, piece = connected_components(links, directed=False)
    for half in (split.upper, ~split.upper):
        assert len(set(piece[half & (net.meeting > 0)])) == 1


@pytest.mark.slow
def test_solids_of_halves_are_of_one_piece() -> None:
    parts = parts_of("6d-tilted-sun-12", ProbeSizes(outer_mm=130.0, kernel_mm=13.0, flare=1.0))
    for part in parts.parts:
        solid = part.solid()
        assert solid is not None
        assert len(solid.decompose()) == 1
