"""The search against all correlations at once, which are looked through one by one."""

from functools import cache

import pytest
import torch

from skylight.csc import _correlation as filter_group, _dictionary as dictionary
from skylight.csc._dictionary import FilterBank
from skylight.csc._positions import Positions
from skylight.csc._search import Atom, Query, Search
from skylight.csc._sub_dictionaries import BoxDictionary, SubDictionary
from skylight.csc._wigner import RotationCorrelation, atom_norms, rotated_filters
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._latlong_transform import LatLongTransform
from tests.csc.draws import F64, random

DEGREE, ROWS, TWISTS = 6, 7, 4


@cache
def parts() -> tuple[SubDictionary, SubDictionary, BoxDictionary]:
    """Filters with and without symmetry, the constant; round ones at other places; boxes."""
    bank = FilterBank(
        torch.cat([dictionary.anisotropic(DEGREE, 4).coefficients[:3], random(2, 49)]), "mixed"
    )
    turned = SubDictionary(bank, Positions(rows=ROWS, twists=TWISTS), dtype=F64)
    rows = dictionary.isotropic(DEGREE, 3).coefficients[1:]
    round_ = SubDictionary(
        FilterBank(rows, "round"), Positions(rows=9, twists=1), first=5, dtype=F64
    )
    return turned, round_, BoxDictionary(10, 8, DEGREE, sizes=((1, 1), (1, 2)))


@cache
def columns() -> tuple[list[Atom], torch.Tensor]:
    """Every atom that differs from those before it, and its coordinates, without correlation."""
    turned, round_, boxes = parts()
    atoms: list[Atom] = []
    coordinates = []
    for part, repeats in ((turned, [1, 2, 2, 4, 4]), (round_, [1] * 3)):
        p = part.positions
        for place, filter_ in enumerate(part.bank.coefficients.detach()):
            axes = (torch.arange(n) for n in (p.rows, p.columns, repeats[place]))
            places = torch.cartesian_prod(*axes)
            rotated = rotated_filters(filter_.expand(len(places), -1), p.rotations(places))
            coordinates.append(torch.nn.functional.pad(rotated, (0, 200)))
            atoms += [(part.first + place, tuple(at)) for at in places.tolist()]
    root = DirectionGrid.latlong(10).solid_angles.sqrt()
    pixels = torch.eye(200, dtype=F64).view(10, 20, 200)
    pairs = (pixels + pixels.roll(-1, 1)) * 0.5**0.5
    for place, each in enumerate((pixels.flatten(0, 1), pairs.flatten(0, 1))):
        coordinates.append(torch.nn.functional.pad(each / root[:, None], (49, 0)))
        atoms += [
            (boxes.first + place, (row, column, 0)) for row in range(10) for column in range(20)
        ]
    return atoms, torch.cat(coordinates)


def expected(query: Query, *, absolute: bool, norms: torch.Tensor | None) -> dict[Atom, float]:
    atoms, coordinates = columns()
    values = coordinates @ query.residual
    values = values.abs() if absolute else values
    if norms is not None:
        values = values / norms
    found = dict(zip(atoms, values.tolist(), strict=True))
    for filter_, place in query.taken:
        gone = [a for a in found if a[0] == filter_] if filter_ == 0 else [(filter_, place)]
        found |= dict.fromkeys(gone, 0.0)
    return found


@pytest.mark.parametrize("absolute", [True, False])
@pytest.mark.parametrize("budget", [1, 2**19])
@pytest.mark.parametrize("normed", [False, True])
def test_the_strongest_are_those_of_all(
    absolute: bool, budget: int, normed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Several residuals at once, with atoms in use; values a row at a time and all together."""
    monkeypatch.setattr(filter_group, "_CACHED", budget)
    plans = [part.plan() for part in parts()]
    norms, of_atoms = None, None
    if normed:
        transform = LatLongTransform(DEGREE, ROWS)
        assert isinstance(plans[0].correlation, RotationCorrelation)
        norms = atom_norms(plans[0].correlation, transform)
        atoms, coordinates = columns()
        maps = transform.synthesise(coordinates[:, :49])
        of_atoms = (maps.square() * transform.solid_angles).sum((1, 2)).sqrt()
        of_atoms[[a[0] >= 5 for a in atoms]] = 1
    search = Search(plans=plans, absolute=absolute, norms=norms)
    first = Query(residual=random(249), taken=())
    queries = [first]
    for seed in (1, 2):
        residual = random(249, seed=seed)
        everything = expected(Query(residual=residual, taken=()), absolute=absolute, norms=of_atoms)
        # the best of all, and the constant at one of its rotations
        taken = [max(everything, key=everything.__getitem__), (0, (3, 5, 0))]
        left = expected(Query(residual=residual, taken=taken), absolute=absolute, norms=of_atoms)
        least = sorted(left.values())[-40 if seed == 1 else -4] * (1 - 1e-9)
        queries.append(Query(residual=residual, taken=taken, rivals=10, least=least))
    for found, query in zip(search.strongest(queries), queries, strict=True):
        values = expected(query, absolute=absolute, norms=of_atoms)
        ranked = sorted(values.values(), reverse=True)
        best, *rivals = found
        assert best.value == pytest.approx(ranked[0], rel=1e-9)
        wanted = min(query.rivals, sum(value > query.least for value in ranked))
        assert [each.value for each in rivals] == pytest.approx(ranked[:wanted], rel=1e-9)
        for value, atom in found:
            assert value == pytest.approx(values[atom], rel=1e-9)
        assert len({atom for _, atom in rivals}) == len(rivals)
    assert [len(found) for found in search.strongest(queries)] == [1, 11, 5]


def test_everything_is_every_atoms_value() -> None:
    query = Query(
        residual=random(249, seed=3), taken=[(3, (2, 4, 1)), (8, (1, 2, 0)), (0, (0, 0, 0))]
    )
    search = Search(plans=[part.plan() for part in parts()], absolute=True)
    values = expected(query, absolute=True, norms=None)
    count = 0
    for group, number, which in search.everything(query):
        for spot in torch.cartesian_prod(*(torch.arange(n) for n in group.shape)).tolist():
            atom = search.named(number, which, spot)
            assert float(group[tuple(spot)]) == pytest.approx(values[atom], rel=1e-9, abs=1e-12)
            count += 1
    assert count == len(values)
