import pytest
import torch

from skylight.csc import dictionary
from skylight.csc.correlation import RotationCorrelation
from skylight.csc.dictionary import FilterBank
from skylight.csc.layers import Layer, PixelLayer, degree_of, layer_of, layers_for
from skylight.csc.norms import atom_norms
from skylight.csc.objective import SampledSignal
from skylight.csc.positions import Positions
from skylight.csc.rotated import rotated_filters
from skylight.csc.zonal import ZonalCorrelation
from skylight.sphere.grid import DirectionGrid
from skylight.sphere.latlong_transform import LatLongTransform

F64 = torch.float64


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def bank(name: str = "ani", degree: int = 8) -> FilterBank:
    """The constant, four long lobes, three round ones."""
    rows = dictionary.anisotropic(degree, 4).coefficients
    return FilterBank(rows[[0, 1, 2, 3, 4, 30, 70, 104]], name)


def lopsided(degree: int = 6) -> FilterBank:
    return FilterBank(random(2, (degree + 1) ** 2), "lopsided")


# layers_for


@pytest.mark.parametrize("name", ["ani", "iso", "vmf", "learned"])
@pytest.mark.parametrize("height", [8, 32, 63])
def test_coarse_maps_get_the_dictionary_alone(name: str, height: int) -> None:
    (layer,) = layers_for(bank(name), height)
    assert isinstance(layer, Layer)
    assert layer.correlation.positions == Positions()
    assert (layer.first, layer.count, layer.coordinates) == (0, 8, slice(0, 81))
    assert degree_of([layer]) == 8


def test_finer_maps_get_sharper_filters_and_the_pixel() -> None:
    layers = layers_for(bank(), 64)
    dictionary_, fine, pixel = layers
    assert isinstance(fine, Layer)
    assert isinstance(fine.correlation, ZonalCorrelation)
    assert fine.correlation.positions == Positions(rows=64, twists=1)
    assert fine.bank.degree == degree_of(layers) == 48
    assert isinstance(pixel, PixelLayer)
    assert [each.first for each in layers] == [0, 8, 8 + fine.count]
    assert pixel.coordinates == slice(49**2, 49**2 + 64 * 128)
    owners = [layer_of(layers, f) for f in range(8 + fine.count + 1)]
    assert owners == [0] * 8 + [1] * fine.count + [2]
    assert dictionary_.constant == {0}
    assert fine.constant == frozenset()


def test_iso_stays_isotropic_and_vmf_the_single_lobe() -> None:
    round_ = FilterBank(dictionary.isotropic(8, 3).coefficients, "iso")
    layers = layers_for(round_, 200)
    assert all(each.isotropic for each in layers if isinstance(each, Layer))
    assert [type(each) for each in layers] == [Layer, Layer, PixelLayer]
    # what has a band limit ends at 128 rows; the pixel does not
    assert degree_of(layers) == 96
    assert [each.correlation.positions.rows for each in layers] == [32, 128, 200]
    assert len(layers_for(FilterBank(round_.coefficients[:2], "vmf"), 128)) == 1


# Layer


@pytest.mark.parametrize("kind", ["mixed", "isotropic", "isotropic without twists", "lopsided"])
def test_filters_turned_by_angles_are_those_turned_to_places(kind: str) -> None:
    filters = {"mixed": bank(), "lopsided": lopsided()}.get(kind, dictionary.isotropic(8, 5))
    positions = Positions(rows=6, twists=1 if "without" in kind else 4)
    layer = Layer(filters, positions, 10, dtype=F64)
    assert layer.isotropic == (kind not in ("mixed", "lopsided"))
    assert isinstance(layer.correlation, ZonalCorrelation) == ("without" in kind)
    which = torch.arange(2 * len(filters)) % len(filters)
    generator = torch.Generator().manual_seed(1)
    places = torch.stack(
        [torch.randint(n, (len(which),), generator=generator) for n in (6, 12, positions.twists)], 1
    )
    angles = positions.euler(places)
    turned = layer.turned(10 + which, *angles)
    expected = rotated_filters(filters.coefficients[which], *angles)
    torch.testing.assert_close(turned, expected, atol=1e-12, rtol=0)
    atoms = layer.correlation.rotated(which, places)
    torch.testing.assert_close(turned, atoms, atol=1e-12, rtol=0)


def test_only_the_constant_filter_is_the_same_everywhere() -> None:
    both_signs = torch.cat([lopsided(8).coefficients, bank().coefficients, -torch.eye(1, 81)])
    assert Layer(FilterBank(both_signs, "x"), Positions(rows=4), 5).constant == {7, 15}


# PixelLayer


def test_pixels_are_unit_atoms_of_one_place() -> None:
    rows, degree = 6, 3
    layer, transform = PixelLayer(rows, 9, degree), LatLongTransform(degree, rows)
    places = torch.tensor([[0, 0, 0], [5, 11, 0], [2, 7, 0]])
    maps = layer.correlation.rotated(torch.zeros(3, dtype=torch.long), places).reshape(3, 6, 12)
    assert [int(i) for i in maps.flatten(1).argmax(1)] == [0, 71, 31]
    assert int((maps != 0).sum()) == 3
    grid = DirectionGrid.latlong(rows)
    energy = maps.flatten(1).square() @ grid.solid_angles
    torch.testing.assert_close(energy, torch.ones(3, dtype=F64))
    # correlations with a residual b - H c, which is dw (x - y) at the pixels
    x, c = random(6, 12, 1), random(16 + 72, 1, seed=1)
    signal = SampledSignal.of(x, transform, pixels=True)
    residual = (signal.target - signal.hessian(c))[layer.coordinates, 0]
    y = transform.synthesise(c[:16, 0]) + c[16:, 0].reshape(6, 12)
    (values,) = layer.correlation.by_group(residual)
    expected = (maps.flatten(1) * grid.solid_angles) @ (x[..., 0] - y).flatten()
    found = values[0, 0][places[:, 0], places[:, 1]]
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=0)


# norms


def test_norms_are_those_of_the_sampled_atoms() -> None:
    """By turning every filter to every row and twist, at any column, and squaring its map."""
    degree, rows = 8, 8
    rows_of = torch.cat([bank(degree=degree).coefficients, lopsided(degree).coefficients])
    filters, positions = FilterBank(rows_of, "x"), Positions(rows=rows, twists=4)
    correlation = RotationCorrelation(filters.coefficients, positions, dtype=F64)
    transform = LatLongTransform(degree, rows)
    norms = atom_norms(correlation, transform)
    assert len(norms) == len(correlation.by_group(torch.zeros(81, dtype=F64)))
    spread = []
    for filter_, (group, place) in correlation.index.items():
        twists = norms[group].shape[0]
        places = torch.cartesian_prod(torch.arange(rows), torch.tensor([0, 5]), torch.arange(4))
        angles = positions.euler(places)
        atoms = rotated_filters(filters.coefficients[filter_].expand(len(places), -1), *angles)
        maps = transform.synthesise(atoms)
        expected = (maps.square() * transform.solid_angles).sum((1, 2)).sqrt()
        found = norms[group][places[:, 2] % twists, place, places[:, 0], 0]
        torch.testing.assert_close(found, expected, atol=1e-11, rtol=0)
        spread.append(float(expected.max() - expected.min()))
    assert max(spread) > 0.01  # else there was nothing to see
    assert min(spread) < 1e-12  # the constant


def test_norms_need_the_columns_of_the_map() -> None:
    correlation = RotationCorrelation(bank().coefficients, Positions(rows=8, twists=4))
    with pytest.raises(ValueError, match="32 columns and positions of 16"):
        atom_norms(correlation, LatLongTransform(8, 16))
