"""Derived values follow their tensors."""

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from skylight._modes import Derived


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
    (scale * module()).sum().backward()
    assert torch.equal(scale.grad, module().sum())


def test_tensors_without_storage_or_version() -> None:
    module = Doubled()
    rows = torch.rand(3, 300)
    assert torch.equal(vmap(lambda x: functional_call(module, {"x": x}, ()))(rows), 2 * rows)
    with torch.inference_mode():
        row = torch.rand(300)
        assert torch.equal(functional_call(module, {"x": row}, ()), 2 * row)
