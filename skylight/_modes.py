"""Whatever mode of torch's the caller is in: what lasts longer, and what needs every digit.

Autocast, inference mode, transforms of :mod:`torch.func` and a default device hold for whoever set
them. What is kept for others is computed without, and so is what eight bits would ruin.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, wraps
from typing import Any, Generic, ParamSpec, TypeVar

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

P = ParamSpec("P")
T = TypeVar("T")


def full_precision(like: Tensor) -> torch.autocast:
    """A context without autocast on a tensor's device: for what is exponentiated or compared."""
    kind = like.device.type
    return torch.autocast(kind if torch.amp.is_autocast_available(kind) else "cpu", enabled=False)


def without_autocast(function: Callable[P, T]) -> Callable[P, T]:
    """The function without autocast: a search compares what is nearly equal."""

    @wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> T:
        with torch.autocast("cpu", enabled=False), torch.autocast("cuda", enabled=False):
            return function(*args, **kwargs)

    return inner


def on_cpu(function: Callable[P, T]) -> Callable[P, T]:
    """The function with the CPU for default device: a module's tables are made there, and are
    moved with it."""

    @wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> T:
        # compilers know no device as a context, and each call of torch's within one costs a call
        if torch.compiler.is_compiling() or torch.get_default_device().type == "cpu":
            return function(*args, **kwargs)
        with torch.device("cpu"):
            return function(*args, **kwargs)

    return inner


def single(x: Tensor) -> Tensor:
    """In float32 at least: what autocast made may have eight bits."""
    return x.to(torch.promote_types(x.dtype, torch.float32))


def transformed() -> bool:
    """Whether a transform of :mod:`torch.func` asks, in which values cannot be looked at."""
    stack = torch._C._functorch  # pyright: ignore[reportAttributeAccessIssue]
    return stack.peek_interpreter_stack() is not None


def constant(maxsize: int | None = None) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """:func:`functools.lru_cache` of a table that depends on its arguments alone.

    There is one for each default dtype, which is the process'. It is made in a thread of its own,
    for the other modes belong to threads: a table that someone in inference mode asked for first
    could otherwise be no part of anyone's graph. Within ``torch.compile`` it
    is a part of the graph.
    """

    def decorate(function: Callable[..., T]) -> Callable[..., T]:
        @lru_cache(maxsize)
        def once(dtype: torch.dtype, *args: Any) -> T:
            with ThreadPoolExecutor(1) as thread:
                return thread.submit(function, *args).result()

        @wraps(function)
        def inner(*args: Any) -> T:
            if torch.compiler.is_dynamo_compiling():
                return function(*args)
            return once(torch.get_default_dtype(), *args)

        return inner

    return decorate


class Derived(Generic[T]):
    """Holds what was last computed from tensors, such as a module's parameters and buffers.

    :meth:`of` computes anew after an optimiser's step, ``load_state_dict``, ``.to``, ``.double``
    and any other change that autograd's version counters see, which writes through ``.data`` are
    not. While a source requires a gradient or has a tangent the value is part of the graph, and
    nothing is kept; nor is it for tensors without storage or version, as in
    :func:`torch.func.vmap`, in inference mode, and within ``torch.compile`` and ``torch.export``,
    whose graphs compute the value each time. Copies and pickles hold nothing.
    """

    def __init__(self) -> None:
        # One tuple, for threads: (state of the sources, value, their storages, which are kept so
        # that no other tensor gets their addresses)
        self._latest: tuple[list[tuple[object, ...]], T, list[Tensor]] | None = None

    def __reduce__(self) -> tuple[type["Derived[T]"], tuple[()]]:
        return Derived, ()

    def of(self, sources: Iterable[Tensor], compute: Callable[[], T]) -> T:
        """``compute()`` without autocast, or what it last returned if no source has changed."""
        sources = list(sources)
        with full_precision(sources[0]):
            now = _states(sources)
            if now is None:
                return compute()
            latest = self._latest
            if latest is None or latest[0] != now:
                # tensors of inference mode or of a transform could be no part of a later graph
                with torch.inference_mode(False), torch.no_grad(), torch._C._DisableFuncTorch():
                    latest = now, compute(), [source.detach() for source in sources]
                self._latest = latest
        return latest[1]


def _states(sources: list[Tensor]) -> list[tuple[object, ...]] | None:
    """What changes with the values; None where that cannot be told, or they are to be followed."""
    if torch.compiler.is_compiling():
        return None
    if torch.is_grad_enabled() and any(source.requires_grad for source in sources):
        return None
    try:
        if any(unpack_dual(source).tangent is not None for source in sources):
            return None
        return [(s.data_ptr(), s._version, s.dtype, s.device, s.shape, s.stride()) for s in sources]
    except RuntimeError:
        return None
