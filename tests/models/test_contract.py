"""What every light model promises, over every light model: one line each in ``CASES``."""

import math
from dataclasses import dataclass

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from skylight.csc.code import SparseCode
from skylight.csc.coder import SphericalSparseCoder
from skylight.csc.light import SparseLight
from skylight.models.base import LightModel
from skylight.models.harmonic import HarmonicLight
from skylight.models.sunsky import SunSky
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import direction_from_angles

F64 = torch.float64


@dataclass(frozen=True)
class Case:
    """``sun_tolerance_deg``: how near the brightest pixel of ``starts_towards`` is to what was
    asked, where that is promised."""

    model: LightModel
    sun_tolerance_deg: float | None = None


def sparse(sign: float) -> SparseLight:
    """White everywhere and two lobes; ``sign`` is that of the second's red."""
    coder = SphericalSparseCoder("vmf", banded=True)
    azimuth, zenith = (
        torch.tensor([0.0, 2.0, -1.0]).double(),
        torch.tensor([0.0, 0.8, 1.9]).double(),
    )
    code = SparseCode(
        dictionary=coder.bank.name,
        fingerprint=coder.bank.fingerprint,
        height=coder.height,
        banded=True,
        filters=torch.tensor([0, 1, 1]),
        directions=direction_from_angles(azimuth, zenith),
        twists_rad=torch.zeros(3, dtype=F64),
        weights=torch.tensor([[4.0, 4.0, 4.0], [2.0, 2.0, 1.5], [0.5 * sign, 0.4, 0.3]]).double(),
        relative_error=0.0,
    )
    return SparseLight(code, coder, height=32)


CASES = {
    "sunsky": Case(SunSky(16), sun_tolerance_deg=5.0),
    "sh9": Case(HarmonicLight(2, 32)),
    "sh25": Case(HarmonicLight(4, 32)),
    "sparse, non-negative": Case(sparse(1.0)),
    "sparse, of either sign": Case(sparse(-1.0)),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


def random_params(model: LightModel, count: int, dtype: torch.dtype = F64) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    free = torch.randn(count, model.parameter_count, generator=generator, dtype=dtype)
    return model.from_free(free)


def corner_params(model: LightModel) -> torch.Tensor:
    """All at the lower and all at the upper bounds, 0 and 1 where there is none."""
    low, high = (bound.to(F64) for bound in model.bounds)
    low = torch.where(low.isfinite(), low, 0.0)
    return torch.stack([low, torch.where(high.isfinite(), high, low + 1)])


def test_conforms_to_the_protocol(case: Case) -> None:
    assert isinstance(case.model, LightModel)
    low, high = case.model.bounds
    assert low.shape == high.shape == (case.model.parameter_count,)
    assert (low < high).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_radiance_is_finite_light_in_the_dtype_of_its_parameters(
    case: Case, dtype: torch.dtype
) -> None:
    light = case.model.radiance(random_params(case.model, 3, dtype))
    assert light.shape == (3, len(case.model.grid), 3)
    assert light.dtype == dtype
    assert light.isfinite().all()
    assert (light >= 0).all()
    assert (light > 0).any()


def test_one_by_one_equals_the_batch(case: Case) -> None:
    params = random_params(case.model, 4)
    singles = torch.cat([case.model.radiance(one) for one in params.split(1)])
    torch.testing.assert_close(case.model.radiance(params), singles, rtol=1e-9, atol=1e-12)


def test_same_parameters_same_light(case: Case) -> None:
    params = random_params(case.model, 2)
    assert torch.equal(case.model.radiance(params), case.model.radiance(params))


def test_gradients_are_finite_at_and_within_the_bounds(case: Case) -> None:
    params = torch.cat([corner_params(case.model), random_params(case.model, 3)]).requires_grad_()
    light = case.model.radiance(params)
    (gradient,) = torch.autograd.grad((light**2).sum(), params)
    assert light.isfinite().all()
    assert gradient.isfinite().all()
    assert (gradient[2:] != 0).any(1).all()


def test_gradients_through_the_free_parameters(case: Case) -> None:
    corners = case.model.to_free(corner_params(case.model))
    far = torch.full((2, case.model.parameter_count), 30.0, dtype=F64) * torch.tensor([[1], [-1]])
    free = torch.cat([corners, far]).requires_grad_()
    assert free.isfinite().all()
    light = case.model.radiance(case.model.from_free(free))
    (gradient,) = torch.autograd.grad(light.sum(), free)
    assert gradient.isfinite().all()


@settings(deadline=None, max_examples=50)
@given(data=st.data())
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_from_free_never_leaves_the_bounds(
    name: str, dtype: torch.dtype, data: st.DataObject
) -> None:
    model = CASES[name].model
    scale = data.draw(st.sampled_from([1.0, 30.0, 1e4]))
    values = data.draw(
        st.lists(st.floats(-1, 1), min_size=model.parameter_count, max_size=model.parameter_count)
    )
    params = model.from_free(scale * torch.tensor([values], dtype=dtype))
    low, high = (bound.to(dtype) for bound in model.bounds)
    assert params.isfinite().all()
    assert ((params >= low) & (params <= high)).all()


@settings(deadline=None, max_examples=50)
@given(data=st.data())
@pytest.mark.parametrize("name", CASES)
def test_free_and_back(name: str, data: st.DataObject) -> None:
    model = CASES[name].model
    values = data.draw(
        st.lists(st.floats(-8, 8), min_size=model.parameter_count, max_size=model.parameter_count)
    )
    free = torch.tensor([values], dtype=F64)
    params = model.from_free(free)
    torch.testing.assert_close(model.to_free(params), free, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(model.from_free(model.to_free(params)), params, rtol=1e-8, atol=1e-9)


def test_bounds_survive_the_free_side(case: Case) -> None:
    corners = corner_params(case.model)
    back = case.model.from_free(case.model.to_free(corners))
    torch.testing.assert_close(back, corners, rtol=1e-4, atol=1e-4)


def within_bounds(model: LightModel, params: torch.Tensor) -> bool:
    low, high = (bound.to(params) for bound in model.bounds)
    return bool(((params >= low) & (params <= high)).all())


def test_starts_are_usable(case: Case) -> None:
    starts = case.model.starts()
    assert starts.ndim == 2
    assert len(starts) >= 1
    assert starts.shape[1] == case.model.parameter_count
    assert within_bounds(case.model, starts)
    assert case.model.to_free(starts).isfinite().all()


def upper_mean(model: LightModel, light: torch.Tensor) -> torch.Tensor:
    upper = (model.grid.directions[:, 1] > 0) * model.grid.solid_angles
    return luminance(light).double() @ upper / (2 * math.pi)


def test_starts_towards(case: Case) -> None:
    zenith = torch.deg2rad(torch.tensor([10.0, 35.0, 60.0, 80.0], dtype=F64))
    directions = direction_from_angles(torch.tensor([0.1, 1.6, 3.14, -2.0], dtype=F64), zenith)
    starts = case.model.starts_towards(directions)
    count = starts.shape[1]
    assert starts.shape == (4, count, case.model.parameter_count)
    flat = starts.flatten(0, 1)
    assert within_bounds(case.model, flat)
    light = case.model.radiance(flat)
    mean = upper_mean(case.model, light)
    assert ((mean > 0.5) & (mean < 2)).all()
    if case.sun_tolerance_deg is not None:
        brightest = case.model.grid.directions[luminance(light).argmax(1)]
        cosine = (brightest * directions.repeat_interleave(count, 0)).sum(1)
        assert torch.rad2deg(torch.acos(cosine.clamp(max=1))).max() < case.sun_tolerance_deg


@pytest.mark.parametrize("columns", [1, 16, -5])
def test_azimuth_turns_the_map(case: Case, columns: int) -> None:
    if case.model.azimuth_index is None:
        pytest.skip("this model has no azimuth")
    assert case.model.grid.layout is not None
    height, width = case.model.grid.layout
    params = random_params(case.model, 3)
    turned = params.clone()
    turned[:, case.model.azimuth_index] += columns * 2 * math.pi / width
    image = case.model.radiance(params).reshape(3, height, width, 3)
    torch.testing.assert_close(
        case.model.radiance(turned).reshape(3, height, width, 3),
        torch.roll(image, columns, dims=2),
        rtol=1e-7,
        atol=1e-9,
    )
