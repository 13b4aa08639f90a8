"""Skin that varies over a face: what the objective makes of it."""

from dataclasses import replace

import pytest
import torch

from skylight.faces._skin import PIGMENT_COLOURS, PIGMENT_SPREADS
from skylight.inverse._faces import FaceTerm, ObjectiveWeights
from skylight.inverse._objective import LightObjective
from tests.inverse.test_objective import MODEL, normal, observation, parameters

K = 4


pytestmark = pytest.mark.usefixtures("double")


def varied(seen=None):
    seen = seen or observation()
    count = len(seen.pixels)
    modes = 0.4 * torch.randn(count, K, generator=torch.Generator().manual_seed(4))
    return replace(seen, modes=modes)


def objective(seen, pigment_spread=1.0):
    weights = ObjectiveWeights(pigment_spread=pigment_spread)
    return LightObjective([FaceTerm.of(seen)], MODEL, normal(9), normal(3), weights)


def pigments(count=5):
    generator = torch.Generator().manual_seed(8)
    return 0.2 * torch.randn(count, 1, 2, K, generator=generator)


def test_shading_has_the_albedo_of_each_pixel():
    seen, amounts = varied(), pigments()
    whole = objective(seen)
    light, exposure, specular_scale, albedo, ground, _ = parameters()
    free = whole.pack(light, exposure, specular_scale, albedo, ground, pigments=amounts)
    parts = whole.unpack(free)
    torch.testing.assert_close(parts.pigments, amounts)
    full = whole.ground.append(MODEL(light), ground) * exposure[:, None]
    expected = specular_scale[:, None] * (seen.specular.matrix @ full)
    for b in range(len(free)):
        melanin, blood = (seen.modes @ amount for amount in amounts[b, 0])
        absorbed = torch.stack(
            [melanin * PIGMENT_COLOURS[0][c] + blood * PIGMENT_COLOURS[1][c] for c in range(3)],
            1,
        )
        diffuse = albedo[b] * torch.exp(-absorbed) * (seen.transport.matrix @ full[b])
        torch.testing.assert_close(whole.shading(parts)[0][b], diffuse + expected[b])
    spreads = torch.tensor(PIGMENT_SPREADS)[:, None]
    nll = 0.5 * ((amounts[:, 0] / spreads) ** 2).sum((1, 2))
    torch.testing.assert_close(whole.terms(free)["pigment_prior"], nll)


def test_even_skin_is_that_of_one_albedo():
    given = parameters()
    seen = varied()
    plain = objective(replace(seen, modes=None))
    value = plain(plain.pack(*given))
    with_modes, switched_off = objective(seen), objective(seen, pigment_spread=0.0)
    torch.testing.assert_close(with_modes(with_modes.pack(*given)), value, rtol=1e-13, atol=0)
    assert torch.equal(switched_off(switched_off.pack(*given)), value)
    assert with_modes.size == plain.size + 2 * K
    assert switched_off.size == plain.size
    free = plain.pack(*given)
    assert torch.equal(with_modes.uneven(free), with_modes.pack(*given))
    whole = with_modes.pack(*given, pigments=pigments())
    assert torch.equal(with_modes.uneven(whole), whole)


def test_the_bayes_scale_leaves_the_variation_alone():
    whole = objective(varied())
    free = whole.pack(*parameters(), pigments=pigments())
    torch.testing.assert_close(
        whole.unpack(whole.at_bayes_scale(free)).pigments, whole.unpack(free).pigments
    )


def test_coarser_modes_are_means_over_blocks():
    seen = varied()
    coarse = seen.coarser(1)
    assert coarse.modes is not None
    for mode, place in zip(coarse.modes, coarse.places, strict=True):
        mine = (seen.places // 2 == place).all(1).double() * seen.weights
        torch.testing.assert_close(mode, mine @ seen.modes / mine.sum())
