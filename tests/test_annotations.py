"""Wrong types and shapes are found, in functions and dataclasses, at first and later."""

from dataclasses import dataclass

import pytest
import torch
from beartype import beartype
from jaxtyping import Float, TypeCheckError
from torch import Tensor

from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angle_between
from tests.annotations import FIRST, THEN, at_first_calls


def test_the_package_is_checked() -> None:
    with pytest.raises(TypeCheckError):
        luminance(torch.ones(2, 4))  # no three colours
    with pytest.raises(TypeCheckError):
        angle_between(torch.ones(3), "up")  # type: ignore[arg-type]
    with pytest.raises(TypeCheckError):
        EnvironmentMap(radiance=[0.0])  # type: ignore[arg-type]


def test_a_function_is_checked_at_its_first_calls_and_then_now_and_then() -> None:
    @at_first_calls(typechecker=beartype)
    def double(x: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        return 2 * x

    found = []
    for _ in range(2 * THEN):
        try:
            double(torch.ones(2, 2))
        except TypeCheckError:
            found.append(True)
        else:
            found.append(False)
    assert found[:FIRST] == [True] * FIRST
    assert [k for k, caught in enumerate(found[FIRST:], start=FIRST + 1) if caught] == [
        THEN,
        2 * THEN,
    ]
    assert double.__name__ == "double"


def test_counts_begin_anew_with_each_test() -> None:
    test_a_function_is_checked_at_its_first_calls_and_then_now_and_then()


def test_what_a_function_returns_and_a_dataclass_takes_is_checked() -> None:
    @at_first_calls(typechecker=beartype)
    def flat(x: Float[Tensor, "n m"]) -> Float[Tensor, " n"]:
        return x

    @at_first_calls(typechecker=beartype)
    @dataclass
    class Pair:
        one: Float[Tensor, " n"]
        other: Float[Tensor, " n"]

    with pytest.raises(TypeCheckError):
        flat(torch.ones(2, 3))
    Pair(torch.ones(2), torch.zeros(2))
    with pytest.raises(TypeCheckError):
        Pair(torch.ones(2), torch.zeros(3))
