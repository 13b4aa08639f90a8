"""Outlines of a probe's faces: where they are, and which turns bring them onto themselves."""

import numpy as np

from skylight.probes.partitions._alignment import outline_of, symmetry
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.printed._halves import standing_rotation
from skylight.probes.partitions.printed._solids import ProbeSizes, WallNet

SIZES = ProbeSizes(outer_mm=60.0, kernel_mm=9.0)
CELLS = Cells.of(named_design("6d"))


def test_a_cube_has_its_edges_seen_from_both_faces() -> None:
    outline = outline_of(WallNet.of(CELLS), SIZES)
    coordinates = np.sort(np.abs(outline.places), axis=1)
    np.testing.assert_allclose(coordinates[:, 2], 9.0)
    np.testing.assert_allclose(coordinates[:, 1], 9.0, atol=0.1)
    assert (coordinates[:, 0] < 8.0).all()  # corners belong to three walls
    np.testing.assert_allclose((outline.places * outline.outward).sum(1), 9.0)
    # the face lies towards its middle
    assert (((9.0 * outline.outward - outline.places) * outline.into).sum(1) > 8.9).all()
    np.testing.assert_allclose((outline.into * outline.along).sum(1), 0.0, atol=1e-12)


def test_a_cube_on_its_corner_looks_alike_every_third_turn() -> None:
    net = WallNet.of(CELLS, standing_rotation(CELLS))
    assert symmetry(outline_of(net, SIZES)) == 3
    assert symmetry(outline_of(WallNet.of(CELLS), SIZES)) == 4
