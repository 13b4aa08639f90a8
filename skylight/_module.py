"""``nn.Module`` whose calls have the types of ``forward``, which torch declares as ``Any``."""

from typing import TYPE_CHECKING, ParamSpec, Protocol, TypeVar

from torch import nn

if TYPE_CHECKING:
    P = ParamSpec("P")
    R = TypeVar("R", covariant=True)

    class _Forward(Protocol[P, R]):
        def forward(self, *args: P.args, **kwargs: P.kwargs) -> R: ...

    class Module(nn.Module):
        def __call__(self: _Forward[P, R], *args: P.args, **kwargs: P.kwargs) -> R: ...

else:
    Module = nn.Module
