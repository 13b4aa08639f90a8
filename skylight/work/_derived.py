"""Values derived from tensors, cached until a tensor changes."""

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import torch
from torch import Tensor

T = TypeVar("T")


class Derived(Generic[T]):
    """Holds what was last computed from a module's parameters and buffers.

    :meth:`of` computes anew after an optimiser's step, ``load_state_dict``, ``.to``, ``.double``
    and any other change that autograd's version counters see, which writes through ``.data`` are
    not. While a source requires a gradient the value is part of the graph, and nothing is kept;
    nor is it for tensors without storage or version, as in :func:`torch.func.vmap` and in
    inference mode.
    """

    def __init__(self) -> None:
        self._states: list[tuple[object, ...]] | None = None
        self._storages: list[Tensor] = []  # kept, so that no other tensor gets their addresses
        self._value: T | None = None

    def of(self, sources: Iterable[Tensor], compute: Callable[[], T]) -> T:
        """``compute()``, or what it last returned if no source has changed since."""
        sources = list(sources)
        if torch.is_grad_enabled() and any(source.requires_grad for source in sources):
            return compute()
        try:
            now: list[tuple[object, ...]] = [
                (s.data_ptr(), s._version, s.dtype, s.device) for s in sources
            ]
        except RuntimeError:
            return compute()
        if now != self._states:
            # tensors made in inference mode could be no part of a later graph
            with torch.inference_mode(False), torch.no_grad():
                self._value = compute()
                self._storages = [source.detach() for source in sources]
            self._states = now
        return self._value  # type: ignore[return-value]
