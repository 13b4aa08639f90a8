"""Atoms on the lat-long map, and pursuit with them, against direct sums."""

import math

import pytest
import torch

from skylight.csc._dictionary import anisotropic
from skylight.evaluation._sparse_coding import relative_error
from skylight.sphere import _harmonics as harmonics
from tools.planar_coder import (
    Atom,
    PlanarDictionary,
    pursued,
    refitted,
    solid_angles,
    strongest,
)

HEIGHT = 16


@pytest.fixture(scope="module")
def dictionary() -> PlanarDictionary:
    return PlanarDictionary(anisotropic(10, count=4), HEIGHT, twists=4)


def test_atoms_are_the_filters_about_a_pixel_of_the_equator(dictionary: PlanarDictionary) -> None:
    """Along the equator and along the meridian, steps of pixels are equal angles."""
    bank = anisotropic(10, count=4)
    assert len(dictionary) == 100 + 4 * 4  # isotropic ones have one twist
    zonal = harmonics.orders(10) == 0
    isotropic = (bank.coefficients.detach()[:, ~zonal] == 0).all(1) & ~bank.constant
    angle = torch.arange(6, dtype=torch.float64) * math.pi / HEIGHT
    polar = bank.polar_values(torch.nonzero(isotropic)[:, 0], angle, torch.zeros(1).double())
    # twist 0 comes first, without the constant
    drawn = dictionary.filters[: len(bank) - 1][isotropic[1:]].double()
    for line in (drawn[:, 0, :6], drawn[:, :6, 0], drawn[:, [0, -1, -2, -3, -4, -5], 0]):
        torch.testing.assert_close(
            line / line[:, :1], polar[:, :, 0] / polar[:, :1, 0], atol=1e-5, rtol=1e-5
        )


def test_a_quarter_turn_exchanges_across_and_along(dictionary: PlanarDictionary) -> None:
    first, last = dictionary.filters[:4], dictionary.filters[-8:-4]  # twists of 0 and 90 degrees
    assert (first[:, 0, 3] - first[:, 3, 0]).abs().max() > 0.01
    for a, b in ((first[:, 0, :6], last[:, :6, 0]), (first[:, :6, 0], last[:, 0, :6])):
        torch.testing.assert_close(a / first[:, :1, 0], b / last[:, :1, 0], atol=1e-5, rtol=1e-5)


def test_correlations_and_norms_are_sums_over_pixels(dictionary: PlanarDictionary) -> None:
    grey = torch.rand(HEIGHT, 2 * HEIGHT, generator=torch.Generator().manual_seed(0)).double()
    weight = solid_angles(HEIGHT)
    found, norms = dictionary.correlation(grey), dictionary.norms(weight)
    for filter_, row, column in ((0, 0, 0), (3, 5, 30), (110, 15, 1)):
        (atom,) = dictionary.drawn([Atom(filter=filter_, row=row, column=column)])
        assert float(found[filter_, row, column]) == pytest.approx(
            float((atom * grey).sum()), rel=1e-4
        )
        assert float(norms[filter_, row, column]) == pytest.approx(
            float((atom.square() * weight).sum().sqrt()), rel=1e-4
        )


def test_pursuit_finds_planted_atoms(dictionary: PlanarDictionary) -> None:
    planted = [
        Atom(filter=115, row=4, column=30),
        Atom(filter=60, row=8, column=12),
        Atom(filter=0, row=11, column=20),
    ]
    colours = torch.tensor([[5.0, 4, 3], [2, 3, 4], [1, 1, 2]]).double()
    truth = 0.5 + torch.einsum("khw,kc->hwc", dictionary.drawn(planted), colours)
    scale = solid_angles(HEIGHT)[:, :1, None]
    exact = refitted(truth, dictionary, planted)
    torch.testing.assert_close(exact, truth)
    errors = [
        relative_error(fit, truth, scale)
        for fit in pursued(truth, dictionary, [1, 4, 12], solid_angles(HEIGHT))
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.02


def test_the_next_atom_has_the_largest_weighted_correlation_for_its_weighted_norm() -> None:
    """Of all, by direct sums over 8 rows; each search that leaves out one factor takes another."""
    height = 8
    small = PlanarDictionary(anisotropic(4, count=4), height, twists=2)
    places = [
        Atom(filter=f, row=r, column=c)
        for f in range(len(small))
        for r in range(height)
        for c in range(2 * height)
    ]
    every, weight = small.drawn(places), solid_angles(height)
    generator = torch.Generator().manual_seed(7)
    truth = torch.rand(height, 2 * height, 3, generator=generator, dtype=torch.float64)
    residual = truth - refitted(truth, small, [])

    def best(residual_weight: torch.Tensor, squared_norms: torch.Tensor) -> int:
        left = residual * residual_weight[..., None]
        colour = torch.linalg.eigh(torch.einsum("hwc,hwd->cd", left, left)).eigenvectors[:, -1]
        scores = torch.einsum("khw,hwc,c->k", every, left, colour).abs() / squared_norms.sqrt()
        first, second = scores.topk(2).values
        assert first > 1.005 * second  # no matter of rounding
        return int(scores.argmax())

    weighted = (every.square() * weight).sum((1, 2))
    chosen = best(weight, weighted)
    (found,) = pursued(truth, small, [2], weight)
    torch.testing.assert_close(found, refitted(truth, small, [places[chosen]]))
    for other in (
        best(weight, torch.ones_like(weighted)),
        best(weight, every.square().sum((1, 2))),
        best(torch.ones_like(weight), weighted),
    ):
        assert (found - refitted(truth, small, [places[other]])).abs().max() > 0.01


def test_the_strongest_activations_are_kept_without_those_at_zero() -> None:
    activations = torch.zeros(HEIGHT, 2 * HEIGHT, 3)
    activations[2, 5, 1], activations[9, 31, 0] = 2.0, 3.0
    one, both = strongest(activations, [2, 9], HEIGHT)
    assert one == [Atom(filter=0, row=9, column=31)]
    assert both == [*one, Atom(filter=1, row=2, column=5)]
