"""Estimates on every device: those there are, and one that PyTorch's rules are checked on."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
import torch

from skylight._names import ObjectLightName
from skylight.errors import InputError
from skylight.estimation import _photos as of_photos
from skylight.estimation._photos import estimate_photo
from skylight.estimation.film import _estimate as of_film
from skylight.estimation.film._estimate import FilmSettings, estimate_film
from skylight.inverse import _estimate as entry
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import estimate_each, estimate_light, light_problems
from skylight.inverse._faces import Level
from skylight.inverse._problem import solve
from skylight.inverse._result import Estimate
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.object import _problem as of_object
from skylight.object._problem import ObjectLight, estimate_object_light
from skylight.object._view import ObjectMaterial
from skylight.transport._render import Specular
from tests.checked_device import DEVICE, CheckedDevice
from tests.inverse.test_solve import SUNS, harmonic_ball, observed, watched

LIGHTS = ("sunsky", "autoencoder", "sh9")
FEW = SolverOptions(
    stages=(
        Stage(level=Level(3), starts=3, iterations=3),
        Stage(level=Level(2), starts=1, iterations=3),
    )
)


def estimated(light: str, device: torch.device) -> Estimate:
    observation = harmonic_ball(2)[1] if light == "sh9" else watched(*SUNS[0])[0]
    return estimate_light(observation, light, options=FEW, device=str(device))


@pytest.fixture(scope="module", params=LIGHTS)
def on_cpu(request: pytest.FixtureRequest) -> Estimate:
    return estimated(request.param, torch.device("cpu"))


@pytest.mark.parametrize(
    ("module", "estimate", "given", "first"),
    [
        (entry, estimate_light, [()], "light_problems"),
        (entry, estimate_each, [()], "choose_device"),
        (of_object, estimate_object_light, [(), "sh9"], "choose_device"),
        (of_photos, estimate_photo, ["a.jpg"], "EstimateSettings"),
        (of_film, estimate_film, [Path("a.mp4"), Path("out"), FilmSettings()], "followed_film"),
    ],
)
def test_estimates_pass_autocast_by(
    module: ModuleType,
    estimate: Callable[..., object],
    given: Sequence[object],
    first: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def look(*_: object, **__: object) -> None:
        raise InputError(f"autocast: {torch.is_autocast_enabled('cpu')}")

    monkeypatch.setattr(module, first, look)
    with torch.autocast("cpu", torch.bfloat16), pytest.raises(InputError, match="autocast: False"):
        estimate(*given)


@pytest.mark.slow
def test_no_operation_mixes_devices(on_cpu: Estimate, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole solver, with tensors that refuse to meet those of the CPU: the same to the bit."""
    monkeypatch.setattr(entry, "choose_device", torch.device)
    with CheckedDevice():
        found = estimated(on_cpu.light, DEVICE)
    assert torch.equal(found.params, on_cpu.params)
    assert torch.equal(found.environment.radiance, on_cpu.environment.radiance)
    assert torch.equal(found.rendered, on_cpu.rendered)
    assert (found.terms, found.status) == (on_cpu.terms, on_cpu.status)
    assert found.stats == pytest.approx(on_cpu.stats, rel=1e-9)


@pytest.mark.slow
def test_no_operation_of_a_batch_mixes_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two photographs at once, one with fewer pixels and lower bounds: the CPU's light."""
    whole = watched(*SUNS[0])[0]
    coarse = watched(*SUNS[1])[0].coarser(1)
    level = coarse.pixels.mean(1)
    both = [whole, replace(coarse, clipped=level > level.quantile(0.8))]
    first, second = light_problems("sunsky", 2, options=FEW, device="cpu")
    assert isinstance(first, SkyProblem)
    assert isinstance(second, SkyProblem)
    first.add(both[0])
    second.add(both[1])
    expected = solve([first, second])
    monkeypatch.setattr(entry, "choose_device", torch.device)
    with CheckedDevice():
        found = estimate_each(both, "sunsky", options=FEW, device=str(DEVICE))
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one.environment.radiance, other.environment.radiance)
        assert torch.equal(one.rendered, other.rendered)
        assert (one.terms, one.status) == (other.terms, other.status)
        # small problems of the scan are solved by pivots there, on a CPU by an active set
        assert one.stats == pytest.approx(other.stats, rel=1e-9)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_device_gives_the_cpus_light(on_cpu: Estimate) -> None:
    """Few iterations, so that rounding does not grow: 1 % of the brightest."""
    found = estimated(on_cpu.light, torch.device("cuda"))
    white = on_cpu.environment.radiance.max()
    error = (found.environment.radiance - on_cpu.environment.radiance).abs().max()
    assert float(error / white) < 0.01
    assert found.environment.radiance.device.type == "cpu"


def estimated_object(light: ObjectLightName, device: torch.device) -> ObjectLight:
    """Of a specular ball."""
    diffuse = harmonic_ball(2)[1]
    observation = replace(diffuse, specular=observed(diffuse.pixels.numpy(), rows=32).specular)
    material = ObjectMaterial(albedo=(0.8, 0.5, 0.3), specular=Specular(f0=0.04, roughness=0.4))
    return estimate_object_light(
        observation, light, material=material, activations=6, device=str(device)
    )


def test_no_operation_on_a_known_object_mixes_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Harmonics: the search for a sparse code is tested with those of maps."""
    expected = estimated_object("sh9", torch.device("cpu"))
    monkeypatch.setattr(of_object, "choose_device", torch.device)
    with CheckedDevice():
        found = estimated_object("sh9", DEVICE)
    assert torch.equal(found.coefficients, expected.coefficients)
    assert torch.equal(found.environment.radiance, expected.environment.radiance)
    assert torch.equal(found.rendered, expected.rendered)
    assert found.residual == expected.residual


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("light", ["sh9", "vmf", "lamps"])
def test_a_device_gives_the_cpus_light_of_a_known_object(light: ObjectLightName) -> None:
    expected = estimated_object(light, torch.device("cpu"))
    found = estimated_object(light, torch.device("cuda"))
    white = expected.environment.radiance.max()
    error = (found.environment.radiance - expected.environment.radiance).abs().max()
    assert float(error / white) < 0.01
    assert found.environment.radiance.device.type == found.rendered.device.type == "cpu"


def test_the_checked_device_refuses_to_mix() -> None:
    with CheckedDevice():
        there = torch.ones(3).to(DEVICE)
        assert float((2 * there).sum()) == 6
        with pytest.raises(RuntimeError, match="one device"):
            _ = there + torch.ones(3)
        assert float((there + torch.tensor(1.0)).sum()) == 6  # no dimensions, as PyTorch allows
