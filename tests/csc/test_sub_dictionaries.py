from functools import cache

import pytest
import torch

from skylight.csc import _dictionary as dictionary
from skylight.csc._dictionary import FilterBank
from skylight.csc._least_squares import SampledSignal
from skylight.csc._positions import Positions
from skylight.csc._sub_dictionaries import (
    BoxDictionary,
    SubDictionary,
    degree_of,
    multiresolution,
    part_of,
)
from skylight.csc._wigner import (
    RotationCorrelation,
    ZonalCorrelation,
    atom_norms,
    is_zonal,
    rotated_filters,
)
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._latlong_transform import LatLongTransform
from tests.csc.draws import F64, random


@cache
def rows_of_bank() -> torch.Tensor:
    """The constant, four long lobes, three round ones; of degree 8."""
    return dictionary.anisotropic(8, 4).coefficients.detach()[[0, 1, 2, 3, 4, 30, 70, 104]]


def bank(name: str = "ani") -> FilterBank:
    return FilterBank(rows_of_bank(), name)


def lopsided(degree: int = 6) -> FilterBank:
    return FilterBank(random(2, (degree + 1) ** 2), "lopsided")


# multiresolution


@pytest.mark.parametrize("name", ["ani", "iso", "vmf", "learned"])
@pytest.mark.parametrize("height", [8, 32, 63])
def test_coarse_maps_get_the_dictionary_alone(name: str, height: int) -> None:
    (part,) = multiresolution(bank(name), height)
    plan = part.plan()
    assert plan.correlation.positions == part.positions == Positions()
    assert (part.first, part.count, plan.coordinates) == (0, 8, slice(0, 81))
    assert degree_of([part]) == 8


def test_finer_maps_get_sharper_filters_and_the_pixel() -> None:
    parts = multiresolution(bank(), 64)
    dictionary_, fine, pixel = parts
    assert isinstance(fine, SubDictionary)
    assert isinstance(fine.plan().correlation, ZonalCorrelation)
    assert fine.positions == Positions(rows=64, twists=1)
    assert fine.bank.degree == degree_of(parts) == 48
    assert isinstance(pixel, BoxDictionary)
    assert [each.first for each in parts] == [0, 8, 8 + fine.count]
    assert pixel.coordinates == slice(49**2, 49**2 + 64 * 128)
    owners = [part_of(parts, f) for f in range(8 + fine.count + 1)]
    assert owners == [0] * 8 + [1] * fine.count + [2]
    assert dictionary_.constant == {0}
    assert fine.constant == frozenset()


def test_iso_stays_isotropic_and_vmf_the_single_lobe() -> None:
    round_ = FilterBank(dictionary.isotropic(8, 3).coefficients, "iso")
    parts = multiresolution(round_, 200)
    assert [type(each) for each in parts] == [SubDictionary, SubDictionary, BoxDictionary]
    assert all(is_zonal(each.bank.coefficients) for each in parts[:2])  # type: ignore[union-attr]
    # what has a band limit ends at 128 rows; the pixel does not
    assert degree_of(parts) == 96
    assert [each.positions.rows for each in parts] == [32, 128, 200]
    assert len(multiresolution(FilterBank(round_.coefficients[:2], "vmf"), 128)) == 1


def test_box_has_boxes_at_any_height_in_the_pixels_place() -> None:
    few, boxes = multiresolution(bank("box"), 32)
    assert isinstance(boxes, BoxDictionary)
    assert (few.count, boxes.first, boxes.count) == (8, 8, 36)
    assert boxes.coordinates == slice(81, 81 + 32 * 64)
    fine, pixels = multiresolution(bank("box"), 64), multiresolution(bank(), 64)
    assert [type(each) for each in fine] == [type(each) for each in pixels]
    assert [each.first for each in fine] == [each.first for each in pixels]
    assert (fine[-1].count, pixels[-1].count) == (36, 1)


# SubDictionary


@pytest.mark.parametrize("learnable", [False, True])
@pytest.mark.parametrize("kind", ["mixed", "isotropic", "isotropic without twists", "lopsided"])
def test_rotated_filters_are_the_atoms_of_the_correlation(kind: str, learnable: bool) -> None:
    filters = {"mixed": bank(), "lopsided": lopsided()}.get(kind, dictionary.isotropic(8, 5))
    filters = FilterBank(filters.coefficients, kind, learnable=learnable)
    positions = Positions(rows=6, twists=1 if "without" in kind else 4)
    part = SubDictionary(filters, positions, 10, dtype=F64)
    correlation = part.plan().correlation
    assert isinstance(correlation, ZonalCorrelation) == ("without" in kind)
    which = torch.arange(2 * len(filters)) % len(filters)
    generator = torch.Generator().manual_seed(1)
    places = torch.stack(
        [torch.randint(n, (len(which),), generator=generator) for n in (6, 12, positions.twists)], 1
    )
    rotations = positions.rotations(places)
    atoms = part(10 + which, rotations)
    expected = rotated_filters(filters.coefficients[which], rotations)
    torch.testing.assert_close(atoms, expected, atol=1e-12, rtol=0)
    torch.testing.assert_close(atoms, correlation.rotated(which, places), atol=1e-12, rtol=0)


def test_isotropic_filters_may_become_others() -> None:
    """The gradient of what is isotropic now reaches every order."""
    part = SubDictionary(dictionary.isotropic(3, 2), Positions(rows=6, twists=4))
    atom = part(torch.tensor([1]), torch.tensor([[0.3, 0.7, 0.1]]).double())
    (atom @ random(16)).sum().backward()
    assert part.bank.unnormalised.grad is not None
    assert (part.bank.unnormalised.grad[1, 1:] != 0).all()


def test_only_the_constant_filter_is_the_same_everywhere() -> None:
    both_signs = torch.cat([lopsided(8).coefficients, bank().coefficients, -torch.eye(1, 81)])
    assert SubDictionary(FilterBank(both_signs, "x"), Positions(rows=4), 5).constant == {7, 15}


CHANGES = {
    "a step": lambda bank: bank.unnormalised.detach().mul_(random(*bank.unnormalised.shape) + 2),
    "through .data": lambda bank: bank.unnormalised.data.mul_(random(*bank.unnormalised.shape) + 2),
    "a state": lambda bank: bank.load_state_dict({"unnormalised": random(2, 49, seed=3)}),
    "another parameter": lambda bank: setattr(
        bank, "unnormalised", torch.nn.Parameter(random(2, 49, seed=4))
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_plans_follow_the_filters(change: str) -> None:
    part = SubDictionary(lopsided(), Positions(rows=6, twists=4), dtype=F64)
    before = part.plan()
    assert part.plan() is before
    CHANGES[change](part.bank)
    fresh = RotationCorrelation(part.bank.coefficients.detach(), part.positions, dtype=F64)
    residual = random(49, seed=5)
    (found,), (expected,) = (c.by_group(residual) for c in (part.plan().correlation, fresh))
    torch.testing.assert_close(found, expected, atol=1e-13, rtol=0)
    assert not torch.equal(before.correlation.by_group(residual)[0], found)


def test_plans_follow_the_search_precision() -> None:
    part = SubDictionary(lopsided(), Positions(rows=6, twists=4))
    assert part.plan().correlation.by_group(random(49))[0].dtype == torch.float32
    assert part.double().plan().correlation.by_group(random(49))[0].dtype == F64


# BoxDictionary


def test_pixels_are_unit_atoms_of_one_place() -> None:
    rows, degree = 6, 3
    part, transform = BoxDictionary(rows, 9, degree), LatLongTransform(degree, rows)
    places = torch.tensor([[0, 0, 0], [5, 11, 0], [2, 7, 0]])
    maps = part.correlation.rotated(torch.zeros(3, dtype=torch.long), places).reshape(3, 6, 12)
    assert [int(i) for i in maps.flatten(1).argmax(1)] == [0, 71, 31]
    assert int((maps != 0).sum()) == 3
    grid = DirectionGrid.latlong(rows)
    energy = maps.flatten(1).square() @ grid.solid_angles
    torch.testing.assert_close(energy, torch.ones(3, dtype=F64))
    # correlations with a residual b - H c, which is dw (x - y) at the pixels
    x, c = random(6, 12, 1), random(16 + 72, 1, seed=1)
    signal = SampledSignal.of(x, transform, pixels=True)
    residual = (signal.target - signal.hessian(c))[part.coordinates, 0]
    y = transform.synthesise(c[:16, 0]) + c[16:, 0].reshape(6, 12)
    (values,) = part.correlation.by_group(residual)
    expected = (maps.flatten(1) * grid.solid_angles) @ (x[..., 0] - y).flatten()
    found = values[0, 0][places[:, 0], places[:, 1]]
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=0)


# norms


def test_norms_are_those_of_the_sampled_atoms() -> None:
    """By turning every filter to every row and twist, at any column, and squaring its map."""
    degree, rows = 8, 8
    rows_of = torch.cat([bank().coefficients, lopsided(degree).coefficients])
    filters, positions = FilterBank(rows_of, "x"), Positions(rows=rows, twists=4)
    correlation = RotationCorrelation(filters.coefficients.detach(), positions, dtype=F64)
    transform = LatLongTransform(degree, rows)
    norms = atom_norms(correlation, transform)
    assert len(norms) == len(correlation.by_group(torch.zeros(81, dtype=F64)))
    spread = []
    for filter_, (group, place) in correlation.index.items():
        twists = norms[group].shape[0]
        places = torch.cartesian_prod(torch.arange(rows), torch.tensor([0, 5]), torch.arange(4))
        one = filters.coefficients[filter_].detach()
        atoms = rotated_filters(one.expand(len(places), -1), positions.rotations(places))
        maps = transform.synthesise(atoms)
        expected = (maps.square() * transform.solid_angles).sum((1, 2)).sqrt()
        found = norms[group][places[:, 2] % twists, place, places[:, 0], 0]
        torch.testing.assert_close(found, expected, atol=1e-11, rtol=0)
        spread.append(float(expected.max() - expected.min()))
    assert max(spread) > 0.01  # else there was nothing to see
    assert min(spread) < 1e-12  # the constant
