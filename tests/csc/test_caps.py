import math
from functools import cache

import pytest
import torch

from skylight.csc._code import CodeTensors
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank, anisotropic, isotropic
from skylight.csc._learning import CapFilterBank, cap_lobes, cap_nodes
from skylight.errors import InputError

F64 = torch.float64
DEGREE, RADIUS_RAD = 12, math.radians(50)


@cache
def start() -> FilterBank:
    """The constant and four anisotropic Gaussians."""
    return FilterBank(anisotropic(DEGREE).coefficients[[0, 60, 20, 80, 90]], "start")


def bank(*, signed: bool = False) -> CapFilterBank:
    return CapFilterBank(start(), [1, 3], radius_rad=RADIUS_RAD, signed=signed)


def moved(bank: CapFilterBank) -> CapFilterBank:
    """Amounts of either sign and any norm."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        bank.amounts.add_(torch.randn(bank.amounts.shape, generator=generator, dtype=F64))
    return bank


def test_lobes_are_the_sharpest_gaussian_about_each_node() -> None:
    """Of unit norm, highest at their nodes, the first at the zenith."""
    lobes, nodes = cap_lobes(RADIUS_RAD, DEGREE), cap_nodes(RADIUS_RAD, DEGREE)
    torch.testing.assert_close(lobes[0], isotropic(DEGREE).coefficients[100].detach())
    norms = lobes.norm(dim=1)
    torch.testing.assert_close(norms, torch.ones_like(norms), rtol=0, atol=1e-12)
    heights = FilterBank(lobes, "lobes").evaluate(nodes).detach()
    assert torch.equal(heights.argmax(1), torch.arange(len(nodes)))
    assert float(nodes[:, 1].min()) > math.cos(RADIUS_RAD)


def test_it_starts_at_the_nearest_sums_of_lobes() -> None:
    """Gaussians no sharper than the lobes and well within the cap are nearly met."""
    round_ = isotropic(DEGREE).coefficients[[0, 95, 100]]
    learned = CapFilterBank(FilterBank(round_, "two"), [1, 2], radius_rad=RADIUS_RAD)
    torch.testing.assert_close(learned.coefficients, round_, rtol=0, atol=0.02)
    assert bool((learned.amounts >= 0).all())


def test_only_learned_filters_move_and_all_have_unit_norm() -> None:
    learned = moved(bank())
    rows = learned.coefficients.detach()
    torch.testing.assert_close(rows.norm(dim=1), torch.ones(5, dtype=F64), rtol=0, atol=1e-12)
    others = [0, 2, 4]
    assert torch.equal(rows[others], start().coefficients[others])
    assert not torch.isclose(rows[[1, 3]], bank().coefficients[[1, 3]]).all()
    assert [name for name, _ in learned.named_parameters()] == ["amounts"]


@pytest.mark.parametrize("signed", [False, True])
def test_projection_is_to_unit_filters_of_allowed_signs(signed: bool) -> None:
    learned = moved(bank(signed=signed))
    amounts, rows = learned.amounts.detach().clone(), learned.coefficients.detach()
    learned.project_()
    torch.testing.assert_close(
        (learned.amounts @ learned.lobes).norm(dim=1), torch.ones(2, dtype=F64)
    )
    assert bool((learned.amounts >= 0).all()) != signed
    if signed:
        torch.testing.assert_close(learned.coefficients, rows)
    else:
        assert torch.equal(learned.amounts > 0, amounts > 0)


def test_a_filter_that_vanished_is_a_gaussian_again() -> None:
    learned = bank()
    with torch.no_grad():
        learned.amounts[1] = -1
    learned.project_()
    torch.testing.assert_close(learned.coefficients[3], learned.lobes[0])


def test_coefficients_are_differentiable_in_the_amounts() -> None:
    learned = moved(bank())

    def coefficients(amounts: torch.Tensor) -> torch.Tensor:
        del learned.amounts
        learned.amounts = amounts
        return learned.coefficients

    amounts = learned.amounts.detach().clone().requires_grad_()
    assert torch.autograd.gradcheck(coefficients, [amounts], fast_mode=True)


def test_a_state_makes_the_same_dictionary_and_codes_follow() -> None:
    first, second = moved(bank()), bank()
    first.project_()
    coder = SphericalSparseCoder(second, height=16, activations=3)
    one = torch.tensor([[0.3, 1.2, 0.4]]), torch.ones(1, 3), torch.tensor(1)
    x = SphericalSparseCoder(first, height=16).decode(CodeTensors(torch.tensor([1]), *one)).detach()
    before = coder.relative_error(x, coder(x))
    second.load_state_dict(first.state_dict())
    assert second.fingerprint == first.fingerprint
    expected = SphericalSparseCoder(first, height=16, activations=3)(x)
    for found, of_fresh in zip(coder(x), expected, strict=True):
        assert torch.equal(found, of_fresh)
    assert coder.relative_error(x, coder(x)) < 0.5 * before


@pytest.mark.parametrize(
    ("learned", "radius_deg", "message"),
    [
        ([0], 50, "constant filter"),
        ([5], 50, "0 to 4, got"),
        ([], 50, "0 to 4"),
        ([1, 1], 50, "0 to 4"),
        ([1], 100, "got 100"),
    ],
)
def test_what_cannot_be_learned(learned: list[int], radius_deg: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        CapFilterBank(start(), learned, radius_rad=math.radians(radius_deg))
