"""A device that computes on the CPU and refuses to mix with it: tests of device rules without one.

:class:`CheckedTensor` says that it is on :data:`DEVICE` and holds a CPU tensor. Every operation
that PyTorch dispatches is done on what is held, and answered by one that says the same. As on a
real device, tensors of the two places do not meet in one operation, unless the CPU's has no
dimensions or is an index; ``torch.zeros(3, device=DEVICE)`` is there, ``torch.zeros(3)`` is not;
and ``Tensor.to`` is the only way from one to the other. Whatever a device would have to wait for,
copies and answers to the host, is counted.
"""

import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import FrameType
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_leaves, tree_map, tree_unflatten

from skylight import _modes

DEVICE = torch.device("lazy")  # one that every build knows, and that nothing else here uses
_aten = torch.ops.aten
_INDEXING = {_aten.index.Tensor, _aten.index_put.default, _aten.index_put_.default}
_COPIES = {_aten._to_copy.default, _aten.copy_.default}
# whose answers, or their sizes, the host has to know
_ANSWERS = {
    "_local_scalar_dense",
    "nonzero",
    "masked_select",
    "_unique2",
    "unique_dim",
    "unique_consecutive",
    "bincount",
    "equal",
    "is_nonzero",
    "_linalg_check_errors",
    "repeat_interleave",
}


class CheckedTensor(Tensor):
    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> "CheckedTensor":
        made = Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=DEVICE,
            requires_grad=False,
        )
        made.held = held
        return made

    def __repr__(self) -> str:
        return f"CheckedTensor({self.held!r})"

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None) -> Any:
        return dispatch(function, args, kwargs or {})


class CheckedDevice(TorchDispatchMode):
    """Within it, ``device=DEVICE`` means that device; ``waits`` says what it had to wait for."""

    def __init__(self) -> None:
        super().__init__()
        self.waits: list[str] = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None) -> Any:
        kwargs = kwargs or {}
        if waits(function, args, kwargs):
            frame: FrameType | None = sys._getframe()
            while frame and f"{os.sep}skylight{os.sep}" not in frame.f_code.co_filename:
                frame = frame.f_back
            asked = f" at {frame.f_code.co_filename}:{frame.f_lineno}" if frame else ""
            self.waits.append(f"{function}{asked}")
        return dispatch(function, args, kwargs)

    def __enter__(self) -> "CheckedDevice":
        self._literals = Literals()
        # what is kept for all is made in threads, in which there is no such device
        self._threads = patch.object(_modes, "ThreadPoolExecutor", Here)
        self._threads.start()
        self._literals.__enter__()
        return super().__enter__()

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._literals.__exit__(*error)
        self._threads.stop()


class Here(ThreadPoolExecutor):
    """Of one thread, which is this."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
        class Done:
            @staticmethod
            def result() -> Any:
                return fn(*args, **kwargs)

        return Done


def waits(function, args, kwargs) -> bool:
    """Whether numbers go from one place to the other."""
    tensors = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
    there = [isinstance(x, CheckedTensor) for x in tensors]
    if function in _COPIES:
        to = kwargs.get("device")
        goes = any(there) if to is None else torch.device(to) == DEVICE
        return goes != all(there)
    if not any(there):
        return False
    if function in _INDEXING:
        indices = [x for x in args[1] if x is not None]
        masks = any(x.dtype in (torch.bool, torch.uint8) for x in indices)
        return masks or not all(isinstance(x, CheckedTensor) for x in indices)
    return function._schema.name.split("::")[1] in _ANSWERS


class Literals(TorchFunctionMode):
    """Lists become tensors on the CPU, which are moved: what PyTorch makes of them itself is not
    dispatched."""

    def __torch_function__(self, function, types, args=(), kwargs=None) -> Any:
        kwargs = kwargs or {}
        if function is torch.tensor and kwargs.get("device") == DEVICE:
            return torch.tensor(*args, **{**kwargs, "device": "cpu"}).to(DEVICE)
        if function is Tensor.new_tensor and isinstance(args[0], CheckedTensor):
            kwargs = {"dtype": args[0].dtype, **kwargs}
            return torch.tensor(*args[1:], **kwargs).to(DEVICE)
        if function in (Tensor.__getitem__, Tensor.__setitem__):
            whole = args[1] if isinstance(args[1], tuple) else (args[1],)
            parts = tuple(torch.tensor(i) if isinstance(i, list) else i for i in whole)
            args = (args[0], parts, *args[2:])
        if function is Tensor.tolist and isinstance(args[0], CheckedTensor):
            args = (args[0].cpu(),)
        return function(*args, **kwargs)


def dispatch(function, args, kwargs) -> Any:
    flat, tree = tree_flatten((args, kwargs))
    there = [x for x in flat if isinstance(x, CheckedTensor)]
    here = [x for x in flat if isinstance(x, Tensor) and not isinstance(x, CheckedTensor)]
    if function in _INDEXING and isinstance(args[0], CheckedTensor):
        here = [x for x in here if not any(x is index for index in args[1])]
    assert all(x.device != DEVICE for x in here), f"{function}: made behind the dispatcher's back"
    asked = kwargs.get("device")
    if there and function not in _COPIES and any(x.dim() for x in here):
        raise RuntimeError(f"{function}: expected all tensors on one device")
    on_device = bool(there) if asked is None else torch.device(asked) == DEVICE
    if function is _aten.copy_.default:
        on_device = isinstance(args[0], CheckedTensor)
    args, kwargs = tree_unflatten(
        [x.held if isinstance(x, CheckedTensor) else x for x in flat], tree
    )
    if asked is not None:
        kwargs["device"] = torch.device("cpu")
    answer = function(*args, **kwargs)
    if not on_device:
        return answer
    changed = {id(x.held): x for x in there}  # what an operation writes into keeps its wrapper

    def wrapped(x: Any) -> Any:
        if not isinstance(x, Tensor):
            return x
        # what a conjugate's bit says is not seen from outside
        return changed[id(x)] if id(x) in changed else CheckedTensor(x.resolve_conj())

    return tree_map(wrapped, answer)
