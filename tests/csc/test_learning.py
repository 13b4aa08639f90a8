import math
from itertools import pairwise

import pytest
import torch

from skylight.csc.caps import Cap, Turning
from skylight.csc.coder import SphericalSparseCoder
from skylight.csc.correlation import RotationCorrelation
from skylight.csc.dictionary import FilterBank, anisotropic, isotropic
from skylight.csc.learning import DictionaryLearner, LearningOptions
from skylight.csc.positions import Positions
from skylight.csc.pursuit import PursuitOptions
from skylight.csc.rotated import rotated_filters
from skylight.errors import InputError
from skylight.sphere.latlong_transform import LatLongTransform

F64 = torch.float64
DEGREE, HEIGHT, RADIUS_RAD = 12, 16, math.radians(50)
POSITIONS = Positions()
TURNING = Turning(DEGREE, POSITIONS)
TRANSFORM = LatLongTransform(DEGREE, HEIGHT)
CAP = Cap(RADIUS_RAD, DEGREE)
OPTIONS = LearningOptions(activations=4, rounds=3, steps=10, radius_rad=RADIUS_RAD)


def drawn_places(count: int, generator: torch.Generator) -> torch.Tensor:
    ends = (POSITIONS.rows, POSITIONS.columns, POSITIONS.twists)
    return torch.stack([torch.randint(0, e, (count,), generator=generator) for e in ends], 1)


def planted(shape: str) -> torch.Tensor:
    """A filter that no Gaussian is like: an L, or a ring with a hole."""
    u, v = (
        torch.rad2deg(CAP.theta) * f(torch.atan2(CAP.nodes[:, 0], CAP.nodes[:, 2]))
        for f in (torch.cos, torch.sin)
    )
    if shape == "L":
        on = ((u.abs() < 7) & (v > -7) & (v < 45)) | ((v.abs() < 7) & (u > -7) & (u < 32))
    else:
        on = (torch.hypot(u, v) - 33).abs() < 8
    row = on.double() @ CAP.lobes
    return row / row.norm()


def maps_of(filter_: torch.Tensor, count: int = 8) -> torch.Tensor:
    """A constant and three coloured copies of ``filter_`` in each."""
    generator = torch.Generator().manual_seed(0)
    maps = []
    for _ in range(count):
        atoms = TURNING(filter_.expand(3, -1), drawn_places(3, generator))
        total = atoms.T @ (torch.rand(3, 3, generator=generator, dtype=F64) + 0.5)
        total[0] += 0.3
        maps.append(TRANSFORM.synthesise(total.T).movedim(0, -1))
    return torch.stack(maps)


def start(*others: int) -> FilterBank:
    """The constant, and anisotropic Gaussians of these numbers."""
    return FilterBank(anisotropic(DEGREE).coefficients[[0, *others]], "start")


def learner_of(shape: str, **options: object) -> DictionaryLearner:
    changed = LearningOptions(**{**vars(OPTIONS), **options})  # type: ignore[arg-type]
    return DictionaryLearner(maps_of(planted(shape)), start(60, 20), [1], changed)


def likeness(learner: DictionaryLearner, shape: str) -> float:
    """The largest correlation with the planted filter, over all rotations."""
    rows = learner.bank.coefficients[learner.learnable]
    return float(RotationCorrelation(rows, POSITIONS)(planted(shape)).max())


@pytest.mark.parametrize("shape", ["L", "ring"])
def test_a_planted_filter_is_found_and_no_epoch_raises_the_error(shape: str) -> None:
    learner = learner_of(shape)
    assert likeness(learner, shape) < 0.92
    before = 1.0
    for _ in range(4):
        assert learner.epoch() <= before + 1e-12
        before = learner.error
    assert likeness(learner, shape) > 0.95
    assert learner.errors[-1] < min(0.06, 0.8 * learner.errors[0])
    # a sum of Gaussians that undershoot by 1.8 %
    assert float(learner.bank.undershoot()[1]) < 0.03
    norms = learner.bank.coefficients.norm(dim=1)
    torch.testing.assert_close(norms, torch.ones_like(norms), rtol=0, atol=1e-12)
    assert torch.equal(learner.bank.coefficients[[0, 2]], start(60, 20).coefficients[[0, 2]])


@pytest.mark.parametrize("signed", [False, True])
def test_descent_under_fixed_codes(signed: bool) -> None:
    learner = learner_of("L", signed=signed)
    learner.code()
    before = learner.error
    supports = [(one.support.filters, one.support.places) for one in coded(learner)]
    values = learner.descend()
    assert values[0] == pytest.approx(before, rel=1e-9)
    assert all(b < a for a, b in pairwise(values))
    assert values[-1] < 0.8 * before
    assert learner.error == pytest.approx(values[-1], rel=1e-9)  # norms moved into the weights
    learner.refit()
    assert learner.error <= values[-1]
    for one, (filters, places) in zip(coded(learner), supports, strict=True):
        assert torch.equal(one.support.filters, filters)
        assert torch.equal(one.support.places, places)


def coded(learner: DictionaryLearner) -> list:  # type: ignore[type-arg]
    return learner._maps


def test_the_error_is_that_of_the_decoded_maps() -> None:
    """Through the coder, which turns filters by other means, and in pixels."""
    learner = learner_of("ring")
    learner.code()
    learner.descend()
    coder = SphericalSparseCoder(learner.bank, height=HEIGHT)
    weight = TRANSFORM.solid_angles[..., None]
    errors = []
    for one, truth in zip(coded(learner), maps_of(planted("ring")), strict=True):
        s = one.support
        total = coder.coefficients(s.filters, POSITIONS.euler(s.places), s.weights)
        missed = TRANSFORM.synthesise(total.T).movedim(0, -1) - truth
        errors.append((missed.square() * weight).sum() / (truth.square() * weight).sum())
    assert learner.error == pytest.approx(float(torch.stack(errors).mean()), rel=1e-8)


def test_turning_agrees_with_rotated_filters() -> None:
    generator = torch.Generator().manual_seed(1)
    filters = torch.randn(6, (DEGREE + 1) ** 2, generator=generator, dtype=F64)
    places = drawn_places(6, generator)
    expected = rotated_filters(filters, *POSITIONS.euler(places))
    torch.testing.assert_close(TURNING(filters, places), expected, rtol=0, atol=1e-11)
    assert TURNING(filters[:0], places[:0]).shape == (0, 169)


def test_turning_has_the_inverse_turn_as_its_gradient() -> None:
    """<R d, g> = <d, R^T g>, and rotations keep inner products."""
    generator = torch.Generator().manual_seed(2)
    d, g = torch.randn(2, 5, 169, generator=generator, dtype=F64)
    places = drawn_places(5, generator)
    d.requires_grad_()
    (TURNING(d, places) * g).sum().backward()
    assert d.grad is not None
    torch.testing.assert_close(TURNING(d.grad, places), g, rtol=0, atol=1e-11)


def test_a_cap_holds_what_is_inside_it() -> None:
    """Gaussians no sharper than its own; a lobe as wide as the cap has a rim beyond it."""
    bank = isotropic(DEGREE)
    torch.testing.assert_close(CAP.lobes[0], bank.coefficients[100], rtol=0, atol=1e-12)
    norms = CAP.lobes.norm(dim=1)
    torch.testing.assert_close(norms, torch.ones_like(norms), rtol=0, atol=1e-12)
    inside = bank.coefficients[[95, 100]]
    found = CAP.fit(inside) @ CAP.lobes
    assert float((found - inside).norm(dim=1).max()) < 0.02
    assert bool((CAP.fit(bank.coefficients[[20, 100]]) >= 0).all())
    # a turned cap sees what the function has there
    values = CAP.at(TURNING(inside[:1], torch.tensor([[9, 20, 0]]))[0], *placed(9, 20))
    height = FilterBank(inside[:1], "one").evaluate(CAP.nodes)[0]
    torch.testing.assert_close(values, height, rtol=0, atol=1e-10)


def placed(row: int, column: int) -> tuple[float, float]:
    return float(POSITIONS.alpha[column]), float(POSITIONS.beta[row])


def test_unused_filters_start_anew_where_maps_are_explained_worst() -> None:
    """What a blunt Gaussian leaves of a sharp spot becomes the filter that was too wide for use."""
    wide, blunt, spot = isotropic(DEGREE).coefficients[[20, 70, 100]]
    atoms = TURNING(spot.expand(2, -1), drawn_places(2, torch.Generator().manual_seed(3)))
    grey = TRANSFORM.synthesise(atoms)[..., None].expand(-1, -1, -1, 3)
    options = LearningOptions(activations=1, radius_rad=RADIUS_RAD)
    learner = DictionaryLearner(grey, FilterBank(torch.stack([wide, blunt]), "two"), [0], options)
    learner.code()
    assert learner.used == 0
    assert learner.share == 0
    before = learner.error
    assert learner.replace_unused() == 1
    assert learner.replace_unused() == 0
    assert learner.error == pytest.approx(before, rel=1e-12)
    assert float(learner.bank.coefficients[0] @ spot) > 0.9  # the spot is the cap's middle
    learner.code()
    assert learner.share == 1
    assert learner.error < before


def test_weights_of_one_sign_stay_so() -> None:
    learner = learner_of("ring", pursuit=PursuitOptions(weights="nonnegative"))
    learner.epoch()
    assert all(bool((one.support.weights >= 0).all()) for one in coded(learner))


def test_goes_on_from_its_state() -> None:
    first = learner_of("ring")
    first.epoch()
    state = first.state()
    again = learner_of("ring")
    again.restore(state)
    assert again.errors == first.errors
    assert torch.equal(again.bank.coefficients, first.bank.coefficients)
    assert again.error == first.error
    assert again.descend() == pytest.approx(first.descend(), rel=1e-9)
    assert len(state["errors"]) == 1


@pytest.mark.parametrize(
    ("maps", "learnable", "message"),
    [
        (torch.ones(0, 16, 32, 3), [1], "one or more full lat-long maps"),
        (torch.ones(1, 16, 16, 3), [1], "one or more full lat-long maps"),
        (torch.ones(1, 64, 128, 3), [1], "fewer than 64 rows, got 1 of 64x128"),
        (torch.ones(1, 8, 16, 3), [1], "only 128 directions"),
        (torch.full((1, 16, 32, 3), math.nan), [1], "NaN or infinite"),
        (torch.zeros(1, 16, 32, 3), [1], "black"),
        (torch.ones(1, 16, 32, 3), [0], "constant filter cannot be learned"),
        (torch.ones(1, 16, 32, 3), [3], "different ones of 0 to 1, got"),
        (torch.ones(1, 16, 32, 3), [], "different ones of 0 to 1"),
        (torch.ones(1, 16, 32, 3), [1, 1], "different ones of 0 to 1"),
    ],
)
def test_what_cannot_be_learned(maps: torch.Tensor, learnable: list[int], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        DictionaryLearner(maps, start(60), learnable, OPTIONS)
    assert "\n" not in str(caught.value)


def test_options_are_checked() -> None:
    with pytest.raises(InputError, match="`rounds` must be at least 1"):
        LearningOptions(rounds=0)
    with pytest.raises(InputError, match="at most 90 degrees, got 100"):
        LearningOptions(radius_rad=math.radians(100))
