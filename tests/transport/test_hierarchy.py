"""The hierarchy of boxes: every triangle is in a leaf, and every box holds what is below it."""

import numpy as np
import pytest

from skylight.transport._rays import LEAF, Hierarchy


def soup(count: int) -> np.ndarray:
    random = np.random.default_rng(count)
    return random.normal(size=(count, 1, 3)) + 0.1 * random.normal(size=(count, 3, 3))


@pytest.mark.parametrize("count", [1, 4, 5, 8, 9, 64, 1000, 5000])
def test_leaves_hold_every_triangle(count: int) -> None:
    corners = soup(count)
    leaves = Hierarchy.over(corners).leaves
    assert leaves.shape[1] <= LEAF
    there = {triangle.tobytes() for leaf in leaves for triangle in leaf}
    assert there == {triangle.tobytes() for triangle in corners}


@pytest.mark.parametrize("count", [9, 1000, 4097])
def test_no_triangle_is_there_three_times(count: int) -> None:
    leaves = Hierarchy.over(soup(count)).leaves.reshape(-1, 9)
    _, often = np.unique(leaves, axis=0, return_counts=True)
    assert often.max() <= 2


@pytest.mark.parametrize("count", [5, 64, 1000, 5000])
def test_boxes_are_those_of_what_is_below(count: int) -> None:
    tree = Hierarchy.over(soup(count))
    low, high = tree.leaves.min((1, 2)), tree.leaves.max((1, 2))
    for level in reversed(tree.levels):
        boxes = level.reshape(-1, 2, 3)
        np.testing.assert_array_equal(boxes[:, 0], low)
        np.testing.assert_array_equal(boxes[:, 1], high)
        low, high = level[:, :, 0].min(1), level[:, :, 1].max(1)
    assert len(low) == 1  # the root's


def test_leaves_are_small() -> None:
    """Halving along the longest side makes 512 cells of 4 out of 2,048 points of a cube."""
    centres = np.random.default_rng(0).uniform(size=(2048, 1, 3))
    leaves = Hierarchy.over(np.repeat(centres, 3, 1)).leaves
    sides = np.ptp(leaves[:, :, 0], axis=1)
    assert leaves.shape[:2] == (512, 4)
    # four points in a cube of side 1/8 span 3/5 of it
    assert sides.mean() == pytest.approx(0.6 / 8, rel=0.15)
