"""What every public module promises of devices and of precision: one line each in CASES.

No GPU is needed: tests.checked_device stands for one.
"""

from collections.abc import Iterator
from typing import Any

import pytest
import torch

from skylight.models._base import without_azimuth
from tests.checked_device import DEVICE, CheckedDevice
from tests.modules import CASES, F32, F64, Case, error


@pytest.fixture
def checked() -> Iterator[CheckedDevice]:
    with CheckedDevice() as mode:
        yield mode


@pytest.fixture(
    params=[
        pytest.param(name, marks=pytest.mark.slow if case.slow or case.host else ())
        for name, case in CASES.items()
    ]
)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


def test_waits_are_counted(checked: CheckedDevice) -> None:
    there = torch.arange(6.0).to(DEVICE)
    assert len(checked.waits) == 1
    checked.waits.clear()
    for waits in (
        lambda: float(there[0]),
        lambda: there.tolist(),
        lambda: there[there > 2],
        lambda: there.nonzero(),
        lambda: there[[0, 1]],
        lambda: there.new_tensor([1.0]),
        lambda: torch.tensor([1.0], device=there.device),
        lambda: torch.arange(2.0).to(there),
        lambda: torch.linalg.inv(there[:4].reshape(2, 2)),
    ):
        waits()
        assert checked.waits, waits
        checked.waits.clear()
    there.square().add(torch.zeros(6, device=there.device).roll(1)).sum()
    assert not checked.waits


def test_a_second_call_waits_for_nothing(case: Case, checked: CheckedDevice) -> None:
    """Forward and backward; the first may move what is kept."""
    module = case.single().to(DEVICE).requires_grad_(False)
    given = [x.to(DEVICE) for x in case.given(F32)]
    case.call(module, *given)
    checked.waits.clear()
    value = case.call(module, *(x.requires_grad_() for x in given))
    if value.requires_grad:
        value.square().mean().backward()
    assert value.device == DEVICE
    assert bool(case.host) == bool(checked.waits), checked.waits
    assert error(value, case.truth) < case.float32


def test_results_have_the_precision_of_what_is_given(case: Case) -> None:
    """Whatever a module's own is; bfloat16 and half have 8 and 11 bits, and the truth is theirs."""
    module, double = case.single().requires_grad_(False), case.in_double().requires_grad_(False)
    for dtype in (torch.bfloat16, torch.float16, F64):
        given = case.given(dtype)
        found = case.call(module, *given)
        expected = {"input": dtype, "single": torch.promote_types(dtype, F32), "module": F32}
        assert found.dtype == expected[case.dtype]
        truth = case.call(double, *(x.to(F64) for x in given))
        assert error(found, truth) < max(case.float32, 2 * torch.finfo(found.dtype).eps)
        assert case.call(double, *given).dtype == (F64 if case.dtype == "module" else found.dtype)


def test_a_default_device_moves_nothing(case: Case) -> None:
    """Modules are made on the CPU, and compute where they are."""
    given, truth = case.given(F32), case.truth
    with torch.device("meta"):
        found = case.call(case.single(), *given)
    assert error(found, truth) < case.float32


def test_a_module_elsewhere_is_not_copied(case: Case, checked: CheckedDevice) -> None:
    """As in torch, whose error names both devices."""
    module, given = case.single(), [x.to(DEVICE) for x in case.given(F32)]
    if not any(each.numel() for each in (*module.parameters(), *module.buffers())):
        pytest.skip("it has no tensors")
    with pytest.raises(RuntimeError, match="one device"):
        case.call(module, *given)  # constants come to the device at the first call
    checked.waits.clear()
    with pytest.raises(RuntimeError, match="one device"):
        case.call(module, *given)
    assert case.host or not checked.waits


@pytest.mark.parametrize("name", ["sunsky", "lamps", "harmonics", "autoencoder light, coarse"])
def test_what_else_a_light_model_says_waits_for_nothing(name: str, checked: CheckedDevice) -> None:
    model: Any = CASES[name].single().to(DEVICE)
    for dtype in (F32, F64):  # of parameters, whatever the model's own is
        params = CASES[name].given(dtype)[0].to(DEVICE)
        _ = model.bounds, model.sun_direction(params)
        checked.waits.clear()
        low, high = model.bounds
        free = model.to_free(params)
        assert low.device == high.device == without_azimuth(model, free).device == DEVICE
        again = model.from_free(free)
        sun = model.sun_direction(params)
        assert not checked.waits
        assert again.dtype == free.dtype == dtype
        assert sun is None or sun.dtype == dtype
        assert error(again, params) < 1e-3


def test_an_angle_on_the_device_is_not_asked_for(checked: CheckedDevice) -> None:
    case = CASES["turning relighting"]
    (light,) = case.given(F32)
    module, angle = case.single().to(DEVICE), torch.tensor(0.3).to(DEVICE)
    there = light.to(DEVICE)
    checked.waits.clear()
    found = module(there, angle)
    assert not checked.waits
    assert error(found, case.truth) < case.float32
