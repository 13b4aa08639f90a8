"""Tensor codes in torch's transforms, programs and files, and what no code has masked."""

import io

import pytest
import torch
from torch.func import vmap
from torch.utils._pytree import tree_map

from skylight.csc import CodeTensors, FilterBank, SphericalSparseCoder
from tests.csc.draws import F64, random

MAPS = random(2, 8, 16, 3).abs() + 0.01


def coder() -> SphericalSparseCoder:
    """Filters and boxes of pixels."""
    return SphericalSparseCoder(FilterBank(random(4, 16), "box"), height=8, activations=6)


def codes(of: SphericalSparseCoder) -> CodeTensors:
    """Of both, the second one padded."""
    found = of(MAPS)
    found = found._replace(
        filters=found.filters.index_fill(1, torch.tensor([0]), 7),  # a box of 1 x 4
        count=torch.tensor([6, 4]),
    )
    found.weights[1, 4:], found.rotations[1, 4:], found.filters[1, 4:] = 0, 0, 0
    return found


def test_codes_go_through_vmap() -> None:
    of = coder()
    given = codes(of)
    torch.testing.assert_close(vmap(of.decode)(given), of.decode(given), atol=1e-12, rtol=0)
    found, expected = vmap(of.refit)(MAPS, given), of.refit(MAPS, given)
    assert isinstance(found, CodeTensors)
    torch.testing.assert_close(found.weights, expected.weights, atol=1e-9, rtol=0)


class Decode(torch.nn.Module):
    def __init__(self, of: SphericalSparseCoder) -> None:
        super().__init__()
        self.of = of

    def forward(self, given: CodeTensors) -> torch.Tensor:
        return self.of.decode(given)


def test_a_program_takes_codes_of_any_batch_from_a_file() -> None:
    of = coder()
    two = codes(of)
    three = tree_map(lambda each: each[[1, 0, 1]], two)
    batch = torch.export.Dim("batch")
    program = torch.export.export(
        Decode(of), (two,), dynamic_shapes=(CodeTensors(*[{0: batch}] * 4),)
    )
    file = io.BytesIO()
    torch.export.save(program, file)
    file.seek(0)
    again = torch.export.load(file).module()
    torch.testing.assert_close(again(three), of.decode(three), atol=1e-12, rtol=0)


def test_a_refit_of_one_atom_twice_is_finite_in_float32() -> None:
    """Each has half the weight, as in float64; padding has none, whatever stood there."""
    given = codes(coder())
    twice = given._replace(weights=torch.ones_like(given.weights))
    for each in (twice.filters, twice.rotations):
        each[:, 1] = each[:, 0]
    expected = coder().refit(MAPS, twice)
    single = twice._replace(weights=twice.weights.float())
    found = coder().float().refit(MAPS.float(), single)
    torch.testing.assert_close(found.weights.double(), expected.weights, atol=1e-3, rtol=0)
    torch.testing.assert_close(found.weights[:, 1], found.weights[:, 0], atol=1e-3, rtol=0)
    assert not found.weights[1, 4:].any()


@pytest.mark.slow
def test_coding_compiles_without_breaks() -> None:
    of = coder()
    given = codes(of)
    for call in (
        lambda: of.decode(given),
        lambda: of.refit(MAPS, given).weights,
        lambda: of.relative_error(MAPS, given),
    ):
        compiled = torch.compile(call, fullgraph=True, backend="aot_eager")
        torch.testing.assert_close(compiled(), call(), atol=1e-9, rtol=0)


def test_torch_reads_tensor_codes_as_data() -> None:
    given, file = codes(coder()), io.BytesIO()
    torch.save({"codes": given}, file)
    file.seek(0)
    again = torch.load(file, weights_only=True)["codes"]
    assert isinstance(again, CodeTensors)
    for one, other in zip(again, given, strict=True):
        assert torch.equal(one, other)


def test_what_is_no_activation_adds_nothing() -> None:
    """Padding and numbers that no filter has, whatever else stands there."""
    of = coder()
    expected = codes(of)
    given = tree_map(torch.clone, expected)
    given.filters[1, 4:] = torch.tensor([10**6, -3])
    given.rotations[1, 4:] = torch.nan
    given.weights[1, 4:] = 5.0
    assert torch.equal(of.decode(given), of.decode(expected))
    absent = given._replace(
        filters=torch.full_like(given.filters, of.count), weights=torch.ones(2, 6, 3, dtype=F64)
    )
    assert not of.decode(absent._replace(rotations=expected.rotations)).any()
