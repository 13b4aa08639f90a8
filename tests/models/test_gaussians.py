import math

import pytest
import torch

from skylight.models._gaussians import SHARPNESS_BOUNDS, GaussianLobes
from skylight.sphere._frame import direction_from_angles

F64 = torch.float64


def random_params(model: GaussianLobes, count: int = 2) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    free = torch.randn(count, model.parameter_count, generator=generator, dtype=F64)
    return model.from_free(free)


def one_lobe(
    amplitude: list[float], angles: list[float], sharpness: float, constant: float = 0.0
) -> torch.Tensor:
    return torch.tensor([[*amplitude, *angles, sharpness, *[constant] * 3]], dtype=F64)


def test_six_numbers_a_lobe_and_three_for_the_constant() -> None:
    assert [GaussianLobes(k).parameter_count for k in (1, 4, 49)] == [9, 27, 297]
    with pytest.raises(ValueError, match="1 or more"):
        GaussianLobes(0)


def test_one_lobe_is_the_formula() -> None:
    model = GaussianLobes(1, 16)
    azimuth, zenith, sharpness = 0.7, 0.9, 12.0
    light = model(one_lobe([1.0, 2.0, 4.0], [azimuth, zenith], sharpness, 0.25))[0]
    sun = direction_from_angles(torch.tensor(azimuth), torch.tensor(zenith)).double()
    for pixel in (0, 300, 777):
        cosine = float(model.grid.directions[pixel] @ sun)
        value = math.exp(sharpness * (cosine - 1))
        expected = [0.25 + a * value for a in (1.0, 2.0, 4.0)]
        assert light[pixel].tolist() == pytest.approx(expected, rel=1e-5)


def test_energy_of_a_lobe_is_its_integral_over_the_sphere() -> None:
    # a (1 - e^(-2 kappa)) 2 pi / kappa; at the zenith a sharp lobe is all above the horizon
    model, sharpness = GaussianLobes(1, 64), 40.0
    light = model(one_lobe([1.0, 1.0, 1.0], [0.0, 0.0], sharpness))[0]
    energy = model.grid.solid_angles @ light
    expected = 2 * math.pi / sharpness * (1 - math.exp(-sharpness))
    assert energy.tolist() == pytest.approx([expected] * 3, rel=2e-3)


def test_lobes_add_up_and_their_order_does_not_matter() -> None:
    model = GaussianLobes(2, 8)
    params = random_params(model)
    swapped = torch.cat([params[:, 6:12], params[:, :6], params[:, 12:]], 1)
    torch.testing.assert_close(model(params), model(swapped))
    dark = params[:, -3:].clone().zero_()
    alone = [GaussianLobes(1, 8)(torch.cat([params[:, i : i + 6], dark], 1)) for i in (0, 6)]
    whole = alone[0] + alone[1] + params[:, None, -3:]
    torch.testing.assert_close(model(params), whole)


def test_free_and_back() -> None:
    model = GaussianLobes(3, 8)
    params = random_params(model)
    torch.testing.assert_close(model.from_free(model.to_free(params)), params)
    assert ((params[:, 5] > SHARPNESS_BOUNDS[0]) & (params[:, 5] < SHARPNESS_BOUNDS[1])).all()


def test_far_out_the_light_and_its_gradient_are_finite() -> None:
    model = GaussianLobes(2, 8)
    far = torch.tensor([[300.0], [-300.0]], dtype=F64).expand(2, model.parameter_count)
    free = far.clone().requires_grad_()
    params = model.from_free(free)
    light = model(params)
    (gradient,) = torch.autograd.grad(light.log1p().sum(), free)
    assert light.isfinite().all()
    assert (light >= 0).all()
    assert gradient.isfinite().all()
    assert params[:, 5].tolist() == pytest.approx([SHARPNESS_BOUNDS[1], SHARPNESS_BOUNDS[0]])


def test_the_matching_start_finds_lobes_that_are_there() -> None:
    model = GaussianLobes(2, 16)
    angles = [[-1.2, 0.6], [1.5, 1.1]]
    truth = torch.cat(
        [
            torch.tensor([[3.0, 2.0, 1.0, *angles[0], 16.0]]),
            torch.tensor([[1.0, 2.0, 6.0, *angles[1], 64.0]]),
        ]
    )
    params = torch.cat([truth.reshape(1, -1), torch.full((1, 3), 0.2)], 1)
    found = model.matching_start(model(params))[0, :-3].reshape(2, 6)
    where = direction_from_angles(found[:, 3], found[:, 4])
    for lobe in truth:
        cosine = where @ direction_from_angles(lobe[3], lobe[4])
        assert torch.rad2deg(torch.acos(cosine.max())) < 10  # the table's directions are 11 apart
        assert found[cosine.argmax(), 5] == pytest.approx(float(lobe[5]), rel=3.1)


def test_more_lobes_start_nearer() -> None:
    # a smooth sky that no small number of lobes holds: two crossing waves and a sun
    grid = GaussianLobes(1, 16).grid
    x, y, z = grid.directions.float().unbind(-1)
    grey = 1 + 0.8 * torch.sin(5 * x + 1) * torch.cos(4 * z) + 50 * torch.exp(200 * (y - 1))
    sky = grey[None, :, None].expand(1, -1, 3)
    errors = []
    for lobes in (4, 12, 24):
        model = GaussianLobes(lobes, 16)
        fit = model(model.matching_start(sky))
        errors.append(float((torch.log1p(fit) - torch.log1p(sky)).abs().mean()))
    assert errors[0] > errors[1] > errors[2]


def test_starts_are_batched() -> None:
    model = GaussianLobes(3, 8)
    skies = model(random_params(model, 4)).float()
    apart = torch.cat([model.matching_start(one) for one in skies.split(1)])
    torch.testing.assert_close(model.matching_start(skies), apart)
