from dataclasses import replace

import pytest
import torch

from skylight.probes.partitions.relight._composite import Relighting
from skylight.probes.partitions.relight._transfer import TransferCoefficients


@pytest.fixture
def coefficients() -> TransferCoefficients:
    values = torch.rand(50, 14, 3, generator=torch.Generator().manual_seed(0))
    return TransferCoefficients(values=values, orders=torch.zeros(1).double())


def test_radiance_is_the_sum_over_the_cells_in_each_colour(coefficients):
    light = torch.rand(14, 3, generator=torch.Generator().manual_seed(1))
    expected = sum(light[i] * coefficients.values[:, i] for i in range(14))
    torch.testing.assert_close(Relighting(coefficients)(light), expected)


def test_a_batch_is_each_light_by_itself(coefficients):
    lights = torch.rand(2, 4, 14, 3, generator=torch.Generator().manual_seed(1))
    relighting = Relighting(coefficients)
    found = relighting(lights)
    assert found.shape == (2, 4, 50, 3)
    torch.testing.assert_close(found[1, 2], relighting(lights[1, 2]))


def test_gradients_are_those_of_the_transpose(coefficients):
    relighting = Relighting(coefficients).double()
    light = torch.rand(14, 3, dtype=torch.float64, requires_grad=True)
    residual = torch.rand(50, 3, dtype=torch.float64)
    (relighting(light) * residual).sum().backward()
    expected = torch.einsum("mic,mc->ic", coefficients.values.double(), residual)
    torch.testing.assert_close(light.grad, expected)
    torch.autograd.gradcheck(relighting, (light,))


def test_transfer_is_the_state_and_precision_that_of_the_light(coefficients, device):
    relighting = Relighting(coefficients).to(device)
    light = torch.rand(14, 3, generator=torch.Generator().manual_seed(1)).to(device)
    other = Relighting(replace(coefficients, values=torch.zeros_like(coefficients.values)))
    other.to(device).load_state_dict(relighting.state_dict())
    torch.testing.assert_close(other(light), relighting(light), rtol=0, atol=0)
    assert relighting(light.double()).dtype == torch.float64
    torch.testing.assert_close(relighting(light.double()).float(), relighting(light))
    torch.testing.assert_close(relighting.double()(light), other(light))
