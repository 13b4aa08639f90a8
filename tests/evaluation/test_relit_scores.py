"""How relit pictures are exposed and scored beside the true ones."""

import numpy as np
import pytest
import torch
from skimage.color import rgb2lab

from skylight.evaluation._relit_scores import (
    best_exposed,
    colour_transfer,
    encoded,
    mean_over,
    score,
)
from skylight.evaluation._run import Item
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear

MASK = np.zeros((24, 32), bool)
MASK[4:20, 6:30] = True


def picture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.35, 0.65, (24, 32, 3)).astype(np.float32)


def test_a_transferred_picture_has_the_statistics_of_the_other() -> None:
    moved = colour_transfer(picture(0), 0.9 * picture(1), MASK)
    own, wanted = rgb2lab(moved)[MASK], rgb2lab(0.9 * picture(1))[MASK]
    np.testing.assert_allclose(own.mean(0), wanted.mean(0), atol=0.3)
    np.testing.assert_allclose(own.std(0), wanted.std(0), rtol=0.03)
    same = colour_transfer(picture(0), picture(0), MASK)
    np.testing.assert_allclose(same, picture(0), atol=1e-4)


def test_a_picture_that_is_another_times_a_factor_becomes_that() -> None:
    linear = np.random.default_rng(2).uniform(0.05, 0.9, (24, 32, 3)).astype(np.float32)
    truth = encoded(linear)
    np.testing.assert_allclose(best_exposed(0.3 * linear, truth, MASK), truth, atol=1e-3)


def test_the_exposure_is_nearest_where_most_of_a_picture_is_black() -> None:
    """As a face lit from the side by a lamp alone: the median tells nothing of its strength."""
    truth = np.full((24, 32, 3), 0.1, np.float32)
    truth[:, 20:] = 0.6
    linear = np.where(truth > 0.5, srgb_to_linear(torch.tensor(0.6)).item() / 8, 0)
    shown = best_exposed(linear.astype(np.float32), truth, MASK)
    np.testing.assert_allclose(shown[:, 20:], 0.6, atol=0.01)


def test_what_is_shown_lies_between_black_and_white() -> None:
    shown = encoded(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]))
    middle = float(linear_to_srgb(torch.tensor(0.5)))
    np.testing.assert_allclose(shown, [0, 0, middle, 1, 1], atol=1e-6)


def test_scores_are_of_the_mask_alone() -> None:
    truth = picture(3)
    other = truth.copy()
    other[:1] = 0  # farther from the mask than a window of SSIM reaches
    same = {"srgb_rmse": 0.0, "srgb_psnr": 58.9, "srgb_ssim": 1.0, "blotch": 0.0}
    assert score(other, truth, MASK) == pytest.approx(same, abs=0.03)
    lighter = score(truth + np.float32(0.1), truth, MASK, "_skin")
    assert lighter["srgb_rmse_skin"] == pytest.approx(0.1, abs=1e-5)
    assert lighter["srgb_psnr_skin"] == pytest.approx(20, abs=1e-3)
    assert lighter["srgb_ssim_skin"] < 1
    assert lighter["blotch_skin"] == pytest.approx(0.1, abs=1e-5)  # up to the mask's corners


def test_a_blotch_is_an_error_that_neighbours_share() -> None:
    truth = np.full((60, 60, 3), 0.5, np.float32)
    mask = np.ones((60, 60), bool)
    speck, blotch = truth.copy(), truth.copy()
    speck[30, 30] = 0  # in 81 of 3600 boxes
    blotch[20:32, 20:32, 0] = 0.2
    assert score(speck, truth, mask)["blotch"] == pytest.approx(0.5 / 81, rel=1e-4)
    # 16 boxes lie in it, and 7 x 9 pixels or more of the next 20: of 36, a hundredth of all
    assert 7 / 9 * 0.0999 < score(blotch, truth, mask)["blotch"] <= 0.1001


def test_means_are_compared_over_what_both_have() -> None:
    def item(**rows: float) -> Item:
        return Item(name="", metrics={name: {"blotch": value} for name, value in rows.items()})

    items = [item(relit=1.0, other=4.0), item(relit=3.0, other=4.0), item(relit=9.0), item()]
    assert mean_over(items, "blotch", "other") == 0.5
