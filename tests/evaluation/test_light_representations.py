"""Fits to the whole sphere, and what is written down of them."""

from pathlib import Path

import pytest
import torch

from skylight.evaluation import _light_representations as light_representations
from skylight.evaluation._light_representations import (
    ROWS,
    WHITE,
    LightRepresentations,
    fit_sphere,
    representations,
)
from skylight.evaluation._sky_representations import (
    fit_gaussians,
    fit_harmonics,
    tone_mapped_scores,
)
from skylight.io._files import read_environment_map, write_environment_map
from skylight.models._gaussians import GaussianLobes
from skylight.models._harmonic import HarmonicLight
from skylight.models._sphere import SphereLight
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid


def test_names_say_how_many_floats() -> None:
    found = {name: floats for name, (floats, _) in representations().items()}
    assert all(int(name.rpartition("_")[2]) == floats for name, floats in found.items())
    assert [name for name in found if name.startswith("sh_")] == [
        f"sh_{3 * (degree + 1) ** 2}" for degree in (2, 5, 6, 9)
    ]
    latents = SphereLight(0).latents
    # a factor, the latents, their azimuth, and seven numbers of each lamp
    spheres = [latents + 2 + 7 * lamps for lamps in (0, 3, 4)]
    assert [floats for name, floats in found.items() if name.startswith("sphere_")] == spheres


def test_gaussians_on_the_whole_sphere() -> None:
    """Two lobes, one of them below the horizon, are found again."""
    model = GaussianLobes(2, 16, sphere=True)
    assert len(model.grid) == len(DirectionGrid.latlong(16))
    lobes = [[3.0, 2.0, 1.0, -1.2, 0.6, 16.0], [1.0, 2.0, 6.0, 1.5, 2.3, 10.0]]
    light = model(torch.tensor([[*lobes[0], *lobes[1], 0.2, 0.3, 0.4]]))[0].reshape(16, 32, 3)
    assert tone_mapped_scores(fit_gaussians(light, 2), light)["psnr"] > 40


def test_harmonics_on_the_whole_sphere() -> None:
    params = torch.zeros(1, 27)
    params[0, :3] = 4.0
    params[0, 3:] = 0.3 * torch.randn(24, generator=torch.Generator().manual_seed(1))
    light = HarmonicLight(2, 16)(params)[0].reshape(16, 32, 3)
    assert float(light.min()) > 0
    assert tone_mapped_scores(fit_harmonics(light, 2), light)["psnr"] > 40


def test_the_sphere_model_finds_a_light_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of any brightness, turned, with a lamp: far better than the tone of any map is told apart."""
    monkeypatch.setattr(light_representations, "ROWS", 16)
    model = SphereLight(1, 16)
    params = torch.zeros(1, model.parameter_count)
    params[0, : model.latents] = 0.5 * torch.randn(
        model.latents, generator=torch.Generator().manual_seed(0)
    )
    params[0, model.latents :] = torch.tensor([1.0, 0.3, 0.5, -1.0, 0.5, 0.5, 0.2, -0.3])
    light = 7 * model(params)[0].reshape(16, 32, 3)
    assert tone_mapped_scores(fit_sphere(light, lamps=1), light)["psnr"] > 35


def test_what_is_written_down(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Maps as pictures are exposed: white is WHITE, whatever the file's unit."""
    generator = torch.Generator().manual_seed(0)
    for name, unit in (("a.exr", 3.0), ("b.exr", 1.0)):
        light = unit * (0.2 + torch.rand(ROWS, 2 * ROWS, 3, generator=generator))
        write_environment_map(tmp_path / name, EnvironmentMap(radiance=light))
    (tmp_path / "index.csv").write_text("file,category\na.exr,indoor\nb.exr,outdoor-sun\n")
    given: list[torch.Tensor] = []

    def fit(light: torch.Tensor) -> torch.Tensor:
        given.append(light)
        return 0.5 * light

    monkeypatch.setattr(light_representations, "representations", lambda: {"one_7": (7, fit)})
    assert LightRepresentations(data=tmp_path, count=1).items() == ["a.exr"]
    evaluation = LightRepresentations(data=tmp_path)
    assert evaluation.items() == ["a.exr", "b.exr"]
    item = evaluation.measure("a.exr", tmp_path / "a.png")
    assert item.facts == {"category": "indoor"}
    metrics = item.metrics["one_7"]
    assert set(metrics) == {"psnr", "tone_mapped_ssim", "floats", "seconds"}
    assert (metrics["psnr"], metrics["floats"]) == (100, 7)
    assert float(torch.quantile(given[0], 0.98)) == pytest.approx(WHITE, rel=1e-4)
    there = read_environment_map(tmp_path / "a.exr").radiance
    torch.testing.assert_close(given[0] / given[0].mean(), there / there.mean())
    assert (tmp_path / "a.png").is_file()
