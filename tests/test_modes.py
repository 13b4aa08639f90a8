"""Derived values follow their tensors, and constants are anyone's."""

import copy
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import torch
from torch import Tensor, nn
from torch.autograd import forward_ad
from torch.func import functional_call, grad, jvp, vmap

from skylight import _modes
from skylight._modes import Derived, constant


class Doubled(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.x = nn.Parameter(torch.rand(300), requires_grad=False)
        self.computed = 0
        self._doubled: Derived[Tensor] = Derived()

    def forward(self) -> Tensor:
        return self._doubled.of(self.parameters(), self._double)

    def _double(self) -> Tensor:
        self.computed += 1
        return 2 * self.x


def test_nothing_is_computed_twice() -> None:
    module = Doubled()
    assert torch.equal(module(), module())
    assert module.computed == 1


def test_writes_are_seen_and_evaluation_keeps_no_graph() -> None:
    module = Doubled().requires_grad_()
    for count in (1, 2):
        with torch.no_grad():
            assert torch.equal(module(), 2 * module.x)
            assert not module().requires_grad
            assert module.computed == count
            module.x.mul_(3)
    assert module().requires_grad


def test_tensors_at_the_address_of_earlier_ones_are_others() -> None:
    module = Doubled()
    for _ in range(50):
        given = torch.rand(300)
        assert torch.equal(functional_call(module, {"x": given}, ()), 2 * given)
        del given
    for _ in range(50):
        module.load_state_dict({"x": torch.rand(300)}, assign=True)
        assert torch.equal(module(), 2 * module.x)


def test_after_inference_mode_there_are_gradients() -> None:
    module = Doubled()
    with torch.inference_mode():
        module()
    scale = torch.ones((), requires_grad=True)
    (slope,) = torch.autograd.grad((scale * module()).sum(), scale)
    assert torch.equal(slope, module().sum())


def test_tensors_without_storage_or_version() -> None:
    module = Doubled()
    rows = torch.rand(3, 300)
    assert torch.equal(vmap(lambda x: functional_call(module, {"x": x}, ()))(rows), 2 * rows)
    with torch.inference_mode():
        row = torch.rand(300)
        assert torch.equal(functional_call(module, {"x": row}, ()), 2 * row)


def test_autocast_of_the_first_call_is_not_kept() -> None:
    module, weight = Doubled(), torch.rand(8, 8)
    product: Derived[Tensor] = Derived()
    with torch.autocast("cpu", torch.bfloat16):
        found = product.of([module.x], lambda: weight @ weight)
    assert torch.equal(found, weight @ weight)
    assert product.of([module.x], lambda: weight) is found


def test_after_a_transform_there_are_gradients_copies_and_pickles() -> None:
    module = Doubled()
    scale = torch.ones(())
    assert torch.equal(grad(lambda s: (s * module()).sum())(scale), module().sum())
    assert module.computed == 1
    pickle.dumps(module())
    scale.requires_grad_()
    torch.autograd.grad((scale * module()).sum(), scale)
    derived = module._doubled
    for again in (copy.deepcopy(derived), pickle.loads(pickle.dumps(derived))):
        assert again._latest is None


def test_a_copy_does_not_take_another_tensor_for_its_own() -> None:
    """Addresses are used again once the original is gone."""
    module = Doubled()
    module()
    copied = copy.deepcopy(module)
    del module
    for _ in range(50):
        given = torch.rand(300)
        assert torch.equal(functional_call(copied, {"x": given}, ()), 2 * given)
        del given


def test_tangents_are_followed() -> None:
    module, tangent = Doubled(), torch.rand(300)
    module()
    found = jvp(lambda x: functional_call(module, {"x": x}, ()), (module.x,), (tangent,))[1]
    assert torch.equal(found, 2 * tangent)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(module.x.detach(), tangent)
        found = forward_ad.unpack_dual(functional_call(module, {"x": dual}, ())).tangent
    assert found is not None
    assert torch.equal(found, 2 * tangent)


def test_another_view_of_the_same_numbers_is_another() -> None:
    derived, square = Derived[Tensor](), torch.rand(3, 3)
    for view in (square, square.T):
        assert torch.equal(derived.of([view], lambda view=view: 2 * view), 2 * view)


def test_another_thread_asks_for_another_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    derived, mine, others = Derived[Tensor](), torch.zeros(3), torch.ones(3)

    @contextmanager
    def interrupted(like: Tensor) -> Iterator[None]:
        yield
        if like is mine:
            derived.of([others], lambda: others + 0)

    monkeypatch.setattr(_modes, "full_precision", interrupted)
    assert torch.equal(derived.of([mine], lambda: mine + 0), mine)


def _in_inference(make: Callable[[], Tensor]) -> None:
    with torch.inference_mode():
        make()


def _in_autocast(make: Callable[[], Tensor]) -> None:
    with torch.autocast("cpu", torch.bfloat16):
        make()


def _in_grad(make: Callable[[], Tensor]) -> None:
    grad(lambda x: (x * make()).sum())(torch.ones(()))


def _on_another_device(make: Callable[[], Tensor]) -> None:
    with torch.device("meta"):
        make()


@pytest.mark.parametrize("mode", [_in_inference, _in_autocast, _in_grad, _on_another_device])
def test_a_constant_is_made_as_if_nobody_asked(mode: Callable[..., None]) -> None:
    @constant()
    def table() -> Tensor:
        return torch.arange(9.0).reshape(3, 3) @ torch.full((3, 3), 1.001)

    mode(table)
    assert table() is table()
    assert torch.equal(table(), torch.arange(9.0).reshape(3, 3) @ torch.full((3, 3), 1.001))
    scale = torch.ones((), requires_grad=True)
    (slope,) = torch.autograd.grad((scale * table()).sum(), scale)
    assert torch.equal(slope, table().sum())
    copy.deepcopy(table())


def test_a_constant_of_another_default_precision_is_another() -> None:
    @constant()
    def table() -> Tensor:
        return torch.ones(3)

    torch.set_default_dtype(torch.float64)
    try:
        assert table().dtype == torch.float64
    finally:
        torch.set_default_dtype(torch.float32)
    assert table().dtype == torch.float32
    assert table() is table()


def test_a_constant_fails_as_its_function_does() -> None:
    @constant(2)
    def table(count: int) -> Tensor:
        raise ValueError(f"no table of {count}")

    with pytest.raises(ValueError, match="no table of 3"):
        table(3)
