"""The thesis' errors (Fig. 3.9), and what costs do."""

import pytest
import torch

from skylight.errors import InputError
from skylight.probes.voxel._analysis import transfer_error
from skylight.probes.voxel._interreflection import (
    GlobalReconstruction,
    slot_transfer,
    transfer_vectors,
)
from skylight.probes.voxel._reconstruct import DirectReconstruction
from tests.probes.voxel.shapes import known_of


@pytest.mark.parametrize(
    ("size", "direct", "indirect"),
    [(3, (0.0115, 0.0227), (0.0113, 0.0149)), (5, (0.0113, 0.0224), (0.0094, 0.0127))],
)
def test_errors_are_those_of_figure_3_9(size: int, direct: tuple, indirect: tuple) -> None:
    known = known_of(size)
    for module, (mean, std) in (
        (DirectReconstruction(known), direct),
        (GlobalReconstruction(known), indirect),
    ):
        error = transfer_error(module)
        assert error.mean == pytest.approx(mean, rel=0.06)
        assert error.std == pytest.approx(std, rel=0.03)


def test_squared_errors_are_the_least_without_a_cost_and_grow_with_it() -> None:
    known, true = known_of(5), transfer_vectors(0.8).flatten(2)
    modules = [DirectReconstruction(known)]
    modules += [GlobalReconstruction(known, cost=c) for c in (1.0, 0.1, 0.0)]
    squares = [float((m.weights.double() @ true - true).square().sum()) for m in modules]
    assert squares == sorted(squares, reverse=True)
    terms = [int((m.weights != 0).sum()) for m in modules[1:]]
    assert terms == sorted(terms)


def test_more_captured_slots_are_not_worse() -> None:
    three, five = (transfer_error(GlobalReconstruction(known_of(n))) for n in (3, 5))
    assert five.mean < three.mean
    assert five.std < three.std


def test_captured_slots_stay_as_they_are() -> None:
    known = known_of(3)
    module = GlobalReconstruction(known)
    light = torch.rand(6, 32, 2, 2, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(module(light)[known], light[known])
    assert not module(light)[:, 31].any()  # closed all round


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="cost of a slot"):
        GlobalReconstruction(known_of(3), cost=-1.0)


@pytest.mark.parametrize("albedo", [0.02, 0.1, 0.5, 1.0])
def test_dark_material_is_completed_as_well_as_bright(albedo: float) -> None:
    """A slot costs the same for all albedos: for small ones it comes to direct light alone."""
    known = torch.zeros(6, 32, dtype=torch.bool)
    known[:, [0, 1, 2, 4, 8]] = True
    vectors = slot_transfer(albedo).flatten(1)
    errors = []
    for module in (GlobalReconstruction(known, albedo=albedo), DirectReconstruction(known)):
        missed = module.weights[2].double() @ vectors - vectors
        errors.append(float(missed.norm() / vectors.norm()))
        assert ((module.weights != 0).sum(2)[:, :31] > 0).all()
    assert errors[0] < max(1.02 * errors[1], 0.03)


def test_albedo_of_nothing_is_refused() -> None:
    known = torch.ones(6, 32, dtype=torch.bool)
    for albedo in (0.0, 1.1, float("nan")):
        with pytest.raises(InputError, match="albedo"):
            GlobalReconstruction(known, albedo=albedo)
