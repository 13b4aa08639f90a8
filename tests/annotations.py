"""Annotations are checked at the first calls of each function in a test, later now and then.

jaxtyping's import hook has every function of the package check its arguments, and the shapes of
tensors among them, at every call. In loops that took a third of the time of all tests, and told
nothing that the first rounds had not told; and wrapping thousands of functions that a run never
calls took seconds. So what the hook puts round a function is made when it is first needed.
"""

import dataclasses
import functools
import inspect
from collections import Counter
from collections.abc import Callable
from typing import Any

import jaxtyping
import torch

FIRST, THEN = 8, 32  # calls of each function in a test: the first, and one in so many after them
calls: Counter[str] = Counter()  # in this test, by function
at_every_call = jaxtyping.jaxtyped


def at_first_calls(fn: Any = None, *, typechecker: Any) -> Any:
    """In place of ``jaxtyping.jaxtyped``, for a function or a dataclass."""
    if fn is None:
        return functools.partial(at_first_calls, typechecker=typechecker)
    if inspect.isclass(fn):
        if dataclasses.is_dataclass(fn) and not hasattr(fn.__init__, "__wrapped__"):
            fn.__init__ = at_first_calls(fn.__init__, typechecker=typechecker)
        return fn
    name = f"{fn.__module__}.{fn.__qualname__}"  # of all that one inner function ever was
    checked: Callable | None = None

    @functools.wraps(fn)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        if torch.compiler.is_compiling():  # a check is none of a graph's operations
            return fn(*args, **kwargs)
        calls[name] = count = calls[name] + 1
        if count > FIRST and count % THEN:
            return fn(*args, **kwargs)
        if checked is None:
            checked = at_every_call(fn, typechecker=typechecker)
        return checked(*args, **kwargs)

    return call


jaxtyping.jaxtyped = at_first_calls  # the name by which the hook's decorator is found
