"""What every light model promises, over every light model: one line each in ``CASES``."""

import copy
import math
from collections.abc import Callable
from functools import cache

import pytest
import torch
from hypothesis import given, settings, strategies as st
from torch import nn

from skylight.models._base import LightModel
from skylight.models._bundle import load_bundle
from skylight.models._gaussians import GaussianLobes
from skylight.models._harmonic import HarmonicLight
from skylight.models._lamps import LampsLight
from skylight.models.sunsky import SunSky
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import direction_from_angles

F64 = torch.float64


# how near the brightest pixel of starts_towards is to what was asked, where that is promised
SUN_TOLERANCE_DEG = {"autoencoder": 8.0, "sunsky": 5.0}
CASES: dict[str, Callable[[], nn.Module]] = {
    "autoencoder": lambda: load_bundle().light(),
    "autoencoder, blurred sun": lambda: load_bundle().light(sun_spread_rad=0.025),
    "sunsky": lambda: SunSky(16),
    "lamps": lambda: LampsLight(2, 16),
    "sh9": lambda: HarmonicLight(2, 32),
    "sh25": lambda: HarmonicLight(4, 32),
}
MODULES = CASES | {"gaussians": lambda: GaussianLobes(3, 16)}


@cache
def made(name: str, dtype: torch.dtype) -> nn.Module:
    return CASES[name]().to(dtype)


@pytest.fixture(params=CASES)
def model(request: pytest.FixtureRequest) -> nn.Module:
    """In float64, in which laws and gradients are checked."""
    return CASES[request.param]().double()


@pytest.fixture(params=MODULES)
def make(request: pytest.FixtureRequest) -> Callable[[], nn.Module]:
    return MODULES[request.param]


def random_params(model: nn.Module | LightModel, count: int) -> torch.Tensor:
    """In float64, whatever the model's precision."""
    generator = torch.Generator().manual_seed(0)
    free = torch.randn(count, model.parameter_count, generator=generator, dtype=F64)
    return copy.deepcopy(model).double().from_free(free)


def corner_params(model: LightModel) -> torch.Tensor:
    """All at the lower and all at the upper bounds, 0 and 1 where there is none."""
    low, high = (bound.to(F64) for bound in model.bounds)
    low = torch.where(low.isfinite(), low, 0.0)
    return torch.stack([low, torch.where(high.isfinite(), high, low + 1)])


def test_conforms_to_the_protocol(model: LightModel) -> None:
    assert isinstance(model, LightModel)
    low, high = model.bounds
    assert low.shape == high.shape == (model.parameter_count,)
    assert (low < high).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_radiance_is_finite_light_where_its_parameters_are(
    make: Callable[[], nn.Module], dtype: torch.dtype, device: torch.device
) -> None:
    model = make().to(device, dtype)
    light = model(random_params(make(), 3).to(device, dtype))
    assert light.shape == (3, len(model.grid), 3)
    assert (light.dtype, light.device.type) == (dtype, device.type)
    assert light.isfinite().all()
    assert (light >= 0).all()
    assert (light > 0).any()


@pytest.mark.parametrize("shape", [(), (1,), (0,), (2, 3)])
def test_any_batch_is_its_members_one_by_one(
    make: Callable[[], nn.Module], shape: tuple[int, ...]
) -> None:
    model = make().double()
    params = random_params(model, math.prod(shape))
    batch = params.reshape(*shape, model.parameter_count)
    for function in (model, model.to_free, model.from_free):
        found = function(batch)
        assert found.shape[: len(shape)] == shape
        singles = [function(one[None]) for one in params]
        expected = torch.cat([found.new_empty(0, *found.shape[len(shape) :]), *singles])
        torch.testing.assert_close(found.reshape(expected.shape), expected, rtol=1e-9, atol=1e-12)


def test_gradients_are_the_differences(make: Callable[[], nn.Module]) -> None:
    model = make().double()
    params = random_params(model, 2).requires_grad_()
    assert torch.autograd.gradcheck(model, params, fast_mode=True)
    free = model.to_free(params.detach()).requires_grad_()
    assert torch.autograd.gradcheck(model.from_free, free, fast_mode=True)


def test_the_state_is_all_there_is(make: Callable[[], nn.Module], device: torch.device) -> None:
    """Whatever was computed before, a loaded, converted or stepped module is like a fresh one."""
    trained, model = make().requires_grad_(True), make()
    params = random_params(model, 2).float()
    before = model(params)
    # a step of gradient ascent stands for training
    torch.autograd.backward(trained(params.requires_grad_()).mean())
    with torch.no_grad():
        for weight in trained.parameters():
            weight += 10 * (0 if weight.grad is None else weight.grad)
        params = params.detach()
        expected = trained(params)
        state = trained.state_dict()
        assert len({value.data_ptr() for value in state.values()}) == len(state)
        model.load_state_dict(state)
        assert torch.equal(model(params), expected)
        assert torch.equal(model(params), before) == (not state)
        fresh = make()
        fresh.load_state_dict(state)
        converted = model.double().to(device)(params.double().to(device)).cpu()
        torch.testing.assert_close(converted, fresh.double()(params.double()), rtol=1e-6, atol=0)


def test_same_parameters_same_light(model: LightModel) -> None:
    params = random_params(model, 2)
    assert torch.equal(model(params), model(params))


def test_gradients_are_finite_at_and_within_the_bounds(model: LightModel) -> None:
    params = torch.cat([corner_params(model), random_params(model, 3)]).requires_grad_()
    light = model(params)
    (gradient,) = torch.autograd.grad((light**2).sum(), params)
    assert light.isfinite().all()
    assert gradient.isfinite().all()
    assert (gradient[2:] != 0).any(1).all()


def test_gradients_through_the_free_parameters(model: LightModel) -> None:
    corners = model.to_free(corner_params(model))
    far = torch.full((2, model.parameter_count), 30.0, dtype=F64) * torch.tensor([[1], [-1]])
    free = torch.cat([corners, far]).requires_grad_()
    assert free.isfinite().all()
    light = model(model.from_free(free))
    (gradient,) = torch.autograd.grad(light.sum(), free)
    assert gradient.isfinite().all()


@settings(deadline=None, max_examples=15)
@given(data=st.data())
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_from_free_never_leaves_the_bounds(
    name: str, dtype: torch.dtype, data: st.DataObject
) -> None:
    model = made(name, dtype)
    scale = data.draw(st.sampled_from([1.0, 30.0, 1e4]))
    values = data.draw(
        st.lists(st.floats(-1, 1), min_size=model.parameter_count, max_size=model.parameter_count)
    )
    params = model.from_free(scale * torch.tensor([values], dtype=dtype))
    low, high = (bound.to(dtype) for bound in model.bounds)
    assert params.isfinite().all()
    assert ((params >= low) & (params <= high)).all()


@settings(deadline=None, max_examples=15)
@given(data=st.data())
@pytest.mark.parametrize("name", CASES)
def test_free_and_back(name: str, data: st.DataObject) -> None:
    model = made(name, F64)
    values = data.draw(
        st.lists(st.floats(-8, 8), min_size=model.parameter_count, max_size=model.parameter_count)
    )
    free = torch.tensor([values], dtype=F64)
    params = model.from_free(free)
    torch.testing.assert_close(model.to_free(params), free, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(model.from_free(model.to_free(params)), params, rtol=1e-8, atol=1e-9)


def test_bounds_survive_the_free_side(model: LightModel) -> None:
    corners = corner_params(model)
    back = model.from_free(model.to_free(corners))
    torch.testing.assert_close(back, corners, rtol=1e-4, atol=1e-4)


def within_bounds(model: LightModel, params: torch.Tensor) -> bool:
    low, high = (bound.to(params) for bound in model.bounds)
    return bool(((params >= low) & (params <= high)).all())


def test_starts_are_usable(model: LightModel) -> None:
    starts = model.starts().double()
    assert starts.ndim == 2
    assert len(starts) >= 1
    assert starts.shape[1] == model.parameter_count
    assert within_bounds(model, starts)
    assert model.to_free(starts).isfinite().all()


def upper_mean(model: LightModel, light: torch.Tensor) -> torch.Tensor:
    upper = (model.grid.directions[:, 1] > 0) * model.grid.solid_angles
    return luminance(light).double() @ upper / (2 * math.pi)


def test_starts_towards(model: LightModel) -> None:
    zenith = torch.deg2rad(torch.tensor([10.0, 35.0, 60.0, 80.0], dtype=F64))
    directions = direction_from_angles(torch.tensor([0.1, 1.6, 3.14, -2.0], dtype=F64), zenith)
    starts = model.starts_towards(directions).double()
    count = starts.shape[1]
    assert starts.shape == (4, count, model.parameter_count)
    flat = starts.flatten(0, 1)
    assert within_bounds(model, flat)
    light = model(flat)
    mean = upper_mean(model, light)
    assert ((mean > 0.5) & (mean < 2)).all()
    if model.name in SUN_TOLERANCE_DEG:
        brightest = model.grid.directions[luminance(light).argmax(1)]
        cosine = (brightest * directions.repeat_interleave(count, 0)).sum(1)
        assert torch.rad2deg(torch.acos(cosine.clamp(max=1))).max() < SUN_TOLERANCE_DEG[model.name]


@pytest.mark.parametrize("columns", [1, 16, -5])
def test_azimuth_turns_the_map(model: LightModel, columns: int) -> None:
    if model.azimuth_index is None:
        pytest.skip("this model has no azimuth")
    assert model.grid.layout is not None
    height, width = model.grid.layout
    params = random_params(model, 3)
    turned = params.clone()
    turned[:, model.azimuth_index] += columns * 2 * math.pi / width
    image = model(params).reshape(3, height, width, 3)
    torch.testing.assert_close(
        model(turned).reshape(3, height, width, 3),
        torch.roll(image, columns, dims=2),
        rtol=1e-7,
        atol=1e-9,
    )


def test_more_rows_hold_the_same_light(model: LightModel) -> None:
    """Irradiance from six sides within 3 %, the brightest place within two coarse pixels."""
    params = random_params(model, 4)
    rows = model.grid.layout[0]  # pyright: ignore[reportOptionalSubscript]
    finer = model.on_rows(2 * rows)
    assert finer.grid.layout == tuple(2 * n for n in model.grid.layout)  # pyright: ignore
    normals = torch.cat([torch.eye(3), -torch.eye(3)]).double()
    lit = [
        torch.einsum("nk,n,bnc->bkc", cosines(one, normals), one.grid.solid_angles, one(params))
        for one in (model, finer)
    ]
    torch.testing.assert_close(lit[0], lit[1], rtol=0.03, atol=0.01 * float(lit[0].mean()))
    peaks = [one.grid.directions[luminance(one(params)).argmax(1)] for one in (model, finer)]
    diagonal = math.sqrt(2) * math.pi / (rows if model.grid.is_sphere else 2 * rows)
    assert float((peaks[0] * peaks[1]).sum(1).min()) > math.cos(2 * diagonal)


def cosines(model: LightModel, normals: torch.Tensor) -> torch.Tensor:
    return (model.grid.directions @ normals.T).clamp(min=0)
