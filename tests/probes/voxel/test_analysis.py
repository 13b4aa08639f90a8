"""Figures 3.6 and 3.7, searches against brute force, what a model encodes, and grown probes."""

from itertools import combinations

import numpy as np
import pytest
import torch
from scipy.ndimage import label

from skylight.errors import InputError
from skylight.probes.voxel._analysis import (
    BestSet,
    CameraRing,
    best_sets,
    design_probe,
    inspect,
    probe_residual,
    residuals,
    residuals_by_occluders,
    visible_faces,
)
from skylight.probes.voxel._interreflection import slot_transfer
from skylight.probes.voxel._model import VoxelModel, exposed_faces, star_probe

THREE_PROBE = torch.tensor([[0, 1, 2, 4, 8]])


@pytest.fixture(scope="module")
def exhaustive() -> list[BestSet]:
    return best_sets(5)


def test_residuals_are_those_of_least_squares() -> None:
    rows = slot_transfer(0.8).flatten(1).numpy()
    sets = [[3, 11, 16], [0, 5, 30]]
    found = residuals(torch.tensor(sets))
    for result, members in zip(found.numpy(), sets, strict=True):
        weights = np.linalg.lstsq(rows[members].T, rows.T, rcond=None)[0]
        expected = np.square(rows.T - rows[members].T @ weights).sum(0)
        np.testing.assert_allclose(result, expected, atol=1e-9)


def test_the_three_probe_is_better_than_the_average_set_of_five() -> None:
    """Section 3.4.5: 2.693 against 3.067, the mean over all 169,911 sets."""
    mine = float(residuals(THREE_PROBE).sum()) / 26
    sets = torch.tensor(list(combinations(range(31), 5)))
    chosen = sets[torch.randperm(len(sets), generator=torch.Generator().manual_seed(0))[:4000]]
    per_set = residuals(chosen).sum(1) / 26
    error = float(per_set.std()) / len(chosen) ** 0.5
    assert error < 0.02
    assert mine == pytest.approx(2.693, rel=0.01)
    assert float(per_set.mean()) == pytest.approx(3.067, rel=0.03)
    assert 0.86 < mine / float(per_set.mean()) < 0.92


def test_residuals_fall_with_the_category_of_occluders() -> None:
    means = [float(r.mean()) for r in residuals_by_occluders().values()]
    assert len(means) == 5
    assert means == sorted(means, reverse=True)
    assert means[1] < 0.1 * means[0]  # "decreases error considerably already"
    assert means[4] == 0


def test_the_best_sets_are_the_best_and_fall_in_a_line_up_to_five(
    exhaustive: list[BestSet],
) -> None:
    found = exhaustive
    sizes = [len(s.configurations) for s in found]
    assert sizes == [1, 2, 3, 4, 5]
    for entry in found[:3]:
        sets = torch.tensor(list(combinations(range(31), len(entry.configurations))))
        least = residuals(sets).sum(1).min()
        assert entry.residual * (31 - len(entry.configurations)) == pytest.approx(float(least))
    steps = np.diff([s.residual for s in found])
    assert (steps < -1.9).all()
    assert (steps > -2.6).all()


def test_the_search_is_never_worse_than_the_best_addition_and_sees_the_exhaustive_optimum(
    exhaustive: list[BestSet],
) -> None:
    searched = best_sets(12, exhaustive=1)
    members: list[int] = []
    for entry in searched:
        offers = [[*members, c] for c in range(31) if c not in members]
        left = residuals(torch.tensor(offers)).sum(1)
        members = list(entry.configurations)
        count = len(offers[0])
        assert len(set(members)) == count
        assert entry.residual * (31 - count) <= float(left.min()) * (1 + 1e-9) + 1e-9
    totals = [s.residual * (31 - len(s.configurations)) for s in searched]
    assert totals == sorted(totals, reverse=True)
    assert searched[4].residual <= 1.2 * exhaustive[4].residual


def test_models_are_inspected() -> None:
    report = inspect(star_probe(3))
    assert report.tractable
    assert report.faces.sum() == 30
    assert report.rank.tolist() == [5] * 6
    assert report.direct is not None
    assert report.globally is not None
    table = report.table()
    assert "occluded backward" in table
    assert f"global: {report.globally}" in table
    single = inspect(VoxelModel(occupied=np.ones((1, 1, 1), bool)))
    assert not single.tractable
    assert single.rank.tolist() == [1] * 6


def test_a_symmetric_design_is_no_worse_than_the_five_probe() -> None:
    star = star_probe(5)
    design = design_probe(len(star), beam=3)
    assert len(design.model) <= len(star)
    assert label(design.model.occupied)[1] == 1
    assert design.residual <= probe_residual(star) + 1e-9
    assert probe_residual(design.model) == pytest.approx(design.residual)
    for axis in "xyz":
        np.testing.assert_array_equal(design.model.turned(axis, 1).occupied, design.model.occupied)


def test_all_faces_of_a_cube_are_seen_and_none_in_a_narrow_well() -> None:
    cube = exposed_faces(VoxelModel(occupied=np.ones((1, 1, 1), bool)))
    assert visible_faces(cube, CameraRing()).all()
    solid = np.ones((3, 4, 3), bool)
    solid[1, 1:, 1] = False
    well = exposed_faces(VoxelModel(occupied=solid))
    bottom = (well.orientation == 2) & (well.configuration == 15)
    assert bottom.sum() == 1
    assert not visible_faces(well, CameraRing())[bottom].any()


def test_cameras_above_do_not_see_what_looks_down() -> None:
    cube = exposed_faces(VoxelModel(occupied=np.ones((1, 1, 1), bool)))
    seen = visible_faces(cube, CameraRing(elevations_deg=(15.0, 60.0)))
    assert (seen == (cube.orientation != 3)).all()


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="odd grid"):
        design_probe(7, size=4)
