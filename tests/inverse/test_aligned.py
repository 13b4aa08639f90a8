"""Scores of one map against another: what no error scores, and what each alignment forgives."""

import math
from typing import get_args

import pytest
import torch

from skylight.errors import InputError
from skylight.inverse._scores import SCALE_FREE, Alignment, scale_factor, score, score_maps
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid


def sunny(place: int = 20, seed: int = 0) -> EnvironmentMap:
    generator = torch.Generator().manual_seed(seed)
    up = DirectionGrid.latlong(32).directions[:, 1].reshape(32, 64, 1).float()
    noise = 0.1 * torch.rand(32, 64, 3, generator=generator)
    radiance = torch.tensor([0.8, 1.0, 1.4]) * (0.3 + up.clamp(min=0)) + noise
    radiance[8, place] = 2000.0
    return EnvironmentMap(radiance=radiance)


def test_the_truth_itself_has_no_error() -> None:
    truth = sunny()
    scores, sun_visible = score_maps(truth, truth)
    assert sun_visible
    for metric, values in scores.items():
        best = 1.0 if metric in ("scene_ssim", "brightness") else 0.0
        for value in values.values():
            assert value == pytest.approx(best, abs=1e-5), metric


def test_a_wrong_brightness_is_all_that_alignment_forgives() -> None:
    truth = sunny()
    scores, _ = score_maps(EnvironmentMap(radiance=3 * truth.radiance), truth)
    assert scores["brightness"][SCALE_FREE] == pytest.approx(3, rel=1e-4)
    assert scores["full_dw_mae"]["unaligned"] == pytest.approx(2, rel=1e-4)
    assert scores["diffuse_mae"]["unaligned"] == pytest.approx(2, rel=1e-4)
    for metric, values in scores.items():
        best = 1.0 if metric == "scene_ssim" else 0.0
        for alignment in ("mean", "least_squares"):
            if alignment in values:
                assert values[alignment] == pytest.approx(best, abs=1e-4), metric
        if SCALE_FREE in values and metric != "brightness":
            assert values[SCALE_FREE] == pytest.approx(0, abs=1e-4), metric


def test_a_turned_sun_is_measured_whatever_the_scale() -> None:
    scores, _ = score_maps(sunny(place=24), sunny())
    turn = 4 * 2 * math.pi / 64
    sine = math.sin(math.pi * 8.5 / 32)
    expected = 2 * math.asin(sine * math.sin(turn / 2))
    assert scores["sun_angle_deg"][SCALE_FREE] == pytest.approx(math.degrees(expected), rel=1e-3)
    assert scores["mirror_rmse"]["least_squares"] > 0.5


def test_least_squares_is_the_best_scale_for_rmse() -> None:
    scores, _ = score_maps(sunny(place=30, seed=1), sunny())
    for metric in ("scene_rmse", "mirror_rmse", "silver_rmse", "diffuse_rmse"):
        values = scores[metric]
        assert values["least_squares"] <= min(values["unaligned"], values["mean"]) + 1e-9
        invariant = scores[metric.replace("rmse", "si_rmse")][SCALE_FREE]
        assert values["least_squares"] == pytest.approx(invariant, rel=1e-6)


def test_they_are_the_scores_of_the_projects_tables() -> None:
    predicted, truth = sunny(place=30, seed=1), sunny()
    ours, _ = score_maps(predicted, truth)
    table = score(predicted, truth, sun_visible=True)
    assert ours["scene_mae"]["unaligned"] == pytest.approx(table["mae"])
    assert ours["scene_mae"]["mean"] == pytest.approx(table["mae_aligned"])
    assert ours["scene_rmse"]["mean"] == pytest.approx(table["rmse_aligned"])
    assert ours["scene_ssim"]["unaligned"] == pytest.approx(table["ssim"])
    assert ours["scene_si_rmse"][SCALE_FREE] == pytest.approx(table["si_rmse"])
    for metric in ("full_dw_mae", "sky_dw_mae", "sun_dw_mae", "sun_dw_mae_fixed"):
        assert ours[metric]["mean"] == pytest.approx(table[metric])
    assert ours["sun_angle_deg"][SCALE_FREE] == pytest.approx(table["sun_angle_deg"])


def test_overcast_skies_have_no_score_of_the_sun() -> None:
    truth = EnvironmentMap(radiance=torch.ones(16, 32, 3))
    scores, sun_visible = score_maps(sunny().resize(16), truth)
    assert not sun_visible
    assert not any(metric.startswith("sun_") for metric in scores)


def test_factors() -> None:
    pred = torch.tensor([[1.0, 2.0, 3.0], [0.0, 1.0, 1.0]])
    true = torch.tensor([[2.0, 2.0, 2.0], [1.0, 1.0, 4.0]])
    weights = torch.tensor([1.0, 0.5])
    assert scale_factor(pred, true, "unaligned") == 1
    assert scale_factor(pred, true, "mean") == pytest.approx(12 / 8)
    assert scale_factor(pred, true, "least_squares") == pytest.approx(17 / 16)
    assert scale_factor(pred, true, "mean", weights) == pytest.approx(9 / 7)
    for alignment in get_args(Alignment):
        assert scale_factor(torch.zeros(2, 3), true, alignment) == 1


def test_what_cannot_be_compared_is_told() -> None:
    with pytest.raises(InputError, match="resize one"):
        score_maps(sunny().resize(16), sunny())
    with pytest.raises(InputError, match="full maps"):
        score_maps(sunny().upper(), sunny().upper())
    with pytest.raises(InputError, match="black"):
        score_maps(sunny(), EnvironmentMap(radiance=torch.zeros(32, 64, 3)))
