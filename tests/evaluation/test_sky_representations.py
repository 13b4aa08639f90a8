"""The tone-mapped scores, and the fits that they judge."""

import pytest
import torch

from skylight.evaluation._run import trained_light
from skylight.evaluation._sky_representations import (
    SkyRepresentations,
    fit_gaussians,
    fit_harmonics,
    representations,
    tone_mapped,
    tone_mapped_scores,
)
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.models._gaussians import GaussianLobes
from skylight.models._harmonic import HarmonicLight


def a_sky() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.rand(32, 128, 3, generator=generator)


def test_two_in_a_hundred_values_are_white():
    shown = tone_mapped(a_sky())
    assert float((shown > 0.9999).double().mean()) == pytest.approx(0.02, abs=1e-3)
    assert float(shown.max()) == pytest.approx(1)


def test_equal_skies_score_best_whatever_their_brightness():
    assert tone_mapped_scores(7 * a_sky(), a_sky()) == pytest.approx(
        {"psnr": 100.0, "tone_mapped_ssim": 1.0}, abs=0.01
    )


def test_psnr_of_a_known_difference():
    """Codes that differ by 0.1 everywhere but in the white half: 10 log10(2 / 0.01) = 23.01 dB."""
    true = torch.ones(32, 128, 3)
    true[:, ::2] = srgb_to_linear(torch.tensor(0.5))
    predicted = true.clone()
    predicted[:, ::2] = srgb_to_linear(torch.tensor(0.6))
    assert float(linear_to_srgb(predicted).min()) == pytest.approx(0.6)
    scores = tone_mapped_scores(predicted, true)
    assert scores["psnr"] == pytest.approx(23.01, abs=0.01)
    assert scores["tone_mapped_ssim"] < 1


def test_no_representation_has_more_floats_than_its_column():
    found = representations(trained_light(None))
    harmonics = [f for name, (f, _) in found.items() if name.startswith("sh_")]
    gaussians = [f for name, (f, _) in found.items() if name.startswith("gaussians_")]
    assert harmonics == [27, 48, 75, 108, 147, 300]
    assert all(0 <= h - g <= 5 for h, g in zip(harmonics, gaussians, strict=True))
    assert found["sunsky_10"][0] == 10
    assert found["autoencoder_65"][0] == 65


def test_harmonics_recover_a_sky_of_their_degree():
    model = HarmonicLight(2, 64)
    params = torch.zeros(1, 27)
    params[0, :3] = 4.0  # mean light that the rest does not take below zero
    params[0, 3:] = 0.3 * torch.randn(24, generator=torch.Generator().manual_seed(1))
    sky = model(params)[0, : 32 * 128].reshape(32, 128, 3)
    assert float(sky.min()) > 0
    assert tone_mapped_scores(fit_harmonics(sky, 2), sky)["psnr"] > 40


def test_gaussians_recover_a_sky_of_their_kind():
    model = GaussianLobes(2)
    lobes = [[3.0, 2.0, 1.0, -1.2, 0.6, 16.0], [1.0, 2.0, 6.0, 1.5, 1.1, 40.0]]
    params = torch.tensor([[*lobes[0], *lobes[1], 0.2, 0.3, 0.4]])
    sky = model(params)[0].reshape(32, 128, 3)
    assert tone_mapped_scores(fit_gaussians(sky, 2), sky)["psnr"] > 40


@pytest.mark.slow
def test_one_sky_by_all_representations(tmp_path):
    evaluation = SkyRepresentations(count=1)
    (name,) = evaluation.items()
    item = evaluation.measure(name, tmp_path / "picture.png")
    assert list(item.metrics) == list(representations(trained_light(None)))
    psnr = {method: metrics["psnr"] for method, metrics in item.metrics.items()}
    assert psnr["sh_300"] > psnr["sh_27"]
    assert psnr["gaussians_297"] > psnr["gaussians_27"]
    assert (tmp_path / "picture.png").is_file()
