"""Edges of probes: how many, where they stand, and which are seen."""

import numpy as np
import pytest
import torch

from skylight.probes.voxel._captured import Alignment, edges_of, visible_edges
from skylight.probes.voxel._model import VoxelModel, star_probe
from skylight.probes.voxel._parts import PlacedProbe, VoxelAssembly
from skylight.sphere._rotation import RigidTransform


def placed(model: VoxelModel, voxel_mm: float = 10.0) -> PlacedProbe:
    shift = torch.tensor([5.0, 0, 0], dtype=torch.float64)
    return PlacedProbe(
        VoxelAssembly(
            model=model,
            voxel_mm=voxel_mm,
            board_from_probe=RigidTransform.translating(shift),
        )
    )


@pytest.mark.parametrize(("size", "count"), [(1, 12), (3, 6 * 8 + 12)])
def test_edges_lie_between_faces_of_different_orientation(size: int, count: int) -> None:
    """A cube has 12. Each of the cross' arms has 4 round its tip, 4 along it, and 12 are inner."""
    ends, outward = edges_of(placed(star_probe(size)))
    assert len(ends) == len(outward) == count
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 10)
    across = np.einsum("nc,nc->n", ends[:, 1] - ends[:, 0], outward)
    np.testing.assert_allclose(across, 0, atol=1e-9)


def test_faces_in_one_plane_have_no_edge_between_them() -> None:
    bar = VoxelModel(occupied=np.ones((3, 1, 1), bool))
    ends, _ = edges_of(placed(bar))
    # the long edges in three pieces each, and four round each end
    assert len(ends) == 4 * 3 + 8


def test_a_cube_shows_nine_of_its_edges_from_a_corner() -> None:
    cube = placed(star_probe(1))
    ends, outward = edges_of(cube)
    seen = visible_edges(cube, np.array([90.0, 100.0, 110.0]), ends, outward)
    assert seen.sum() == 9
    # the three that meet in the corner opposite
    far = np.array([5.0, 0, 0])
    hidden = (np.abs(ends - far).max(2) < 1e-9).any(1)
    assert (seen == ~hidden).all()


def test_an_alignment_turns_about_the_middle_and_shifts() -> None:
    probe = placed(star_probe(3))
    middle = probe.assembly.to_board(np.full(3, 1.5))
    one = Alignment(
        centre_mm=middle,
        turn_deg=np.array([0.0, 90.0, 0.0]),
        shift_mm=np.array([1.0, 2.0, 3.0]),
        turn_spread_deg=0.1,
        shift_spread_mm=0.1,
        pictures=5,
    )
    assert one.agrees
    moved = one.applied(probe.assembly)
    np.testing.assert_allclose(moved.to_board(np.full(3, 1.5)), middle + np.array([1, 2, 3]))
    # +X becomes -Z
    tip = moved.to_board(np.array([2.5, 1.5, 1.5])) - moved.to_board(np.full(3, 1.5))
    np.testing.assert_allclose(tip, [0, 0, -10], atol=1e-9)
