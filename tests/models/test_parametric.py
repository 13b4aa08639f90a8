"""The base of light models of the user's own."""

import math

import pytest
import torch

from skylight.errors import InputError
from skylight.models._base import LightModel, ParametricLight
from skylight.models._harmonic import HarmonicLight
from skylight.models._lamps import LampsLight

F64 = torch.float64


class Four(ParametricLight):
    """A parameter of each kind: between two bounds, above one, below one, and any."""

    def __init__(self, **settings: object) -> None:
        bounds = {"low": [-1.0, 2.0, -math.inf, -math.inf], "high": [3.0, math.inf, 5.0, math.inf]}
        super().__init__(4, 8, **(bounds | settings))  # pyright: ignore[reportArgumentType]

    def forward(self, params: torch.Tensor) -> torch.Tensor:
        return params[..., :3].exp()[..., None, :].expand(*params.shape[:-1], len(self.grid), 3)


def test_free_parameters_are_what_the_page_says() -> None:
    """Against the formulas, in float64."""
    free = torch.linspace(-8, 8, 17, dtype=F64)
    params = Four().from_free(free[:, None].expand(-1, 4))
    sigmoid = 1 / (1 + (-free).exp())
    expected = torch.stack([-1 + 4 * sigmoid, 2 + free.exp(), 5 - free.exp(), free], 1)
    torch.testing.assert_close(params, expected)
    torch.testing.assert_close(Four().to_free(params), free[:, None].expand(-1, 4))


def test_slopes_are_finite_everywhere() -> None:
    light = Four().double()
    free = torch.tensor([[-1e4] * 4, [0.3] * 4, [1e4] * 4], dtype=F64, requires_grad=True)
    params = light.from_free(free)
    low, high = light.bounds
    assert ((params >= low) & (params <= high)).all()
    (slope,) = torch.autograd.grad(params.sum(), free)
    assert slope.isfinite().all()
    on_bounds = torch.tensor([[-1.0, 2.0, 5.0, 0.0], [3.0, 2.5, 4.0, 9.0]], dtype=F64)
    back = light.to_free(on_bounds.requires_grad_())
    assert back.isfinite().all()
    (slope,) = torch.autograd.grad(back.sum(), on_bounds)
    assert slope.isfinite().all()
    assert torch.autograd.gradcheck(light.from_free, torch.randn(2, 4, dtype=F64).requires_grad_())


@pytest.mark.parametrize(
    ("light", "meant"),
    [
        (Four(), r"Four's parameters of shape \(2, 1\): give \(..., 4\)$"),
        (Four(low=-math.inf, high=math.inf), "Four's parameters"),
        (HarmonicLight(1, 8), r"HarmonicLight's .*\(..., 12\): 4 coefficients"),
        (LampsLight(1, 8), r"LampsLight's .*\(..., 23\): 16 of the ambient light"),
    ],
)
def test_other_sizes_are_refused_by_name(light: ParametricLight, meant: str) -> None:
    """One parameter too: it was taken for all of them."""
    for call in (light.to_free, light.from_free):
        with pytest.raises(InputError, match=meant):
            call(torch.zeros(2, 1))


def test_it_is_a_light_model_in_few_lines() -> None:
    light = Four(azimuth_index=3)
    assert isinstance(light, LightModel)
    assert light.name == "Four"
    towards = light.starts_towards(torch.tensor([[0.0, 0.6, -0.8], [0.8, 0.6, 0.0]]))
    torch.testing.assert_close(towards[:, 0, 3], torch.tensor([0.0, math.pi / 2]))
    torch.testing.assert_close(towards[:, 0, :3], light.starts()[:, :3].expand(2, 3))
    finer = light.on_rows(16)
    assert finer.grid.layout == (16, 64)
    torch.testing.assert_close(finer.directions.double(), finer.grid.directions, atol=1e-6, rtol=0)
    assert light.directions.shape == (8 * 32, 3)
    assert not light.state_dict()


@pytest.mark.parametrize(
    ("low", "message"),
    [([0.0, 1.0], "Four: give one bound, or one for each of 4"), (9.0, "must be below")],
)
def test_bounds_that_are_none_are_refused(low: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Four(low=low)
