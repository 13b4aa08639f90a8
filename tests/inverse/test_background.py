"""The background as a term: what it costs of maps that it was seen in, its slope, its bounds."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.inverse._background import BEND, ROW_WEIGHT, BackgroundSpreads, BackgroundTerm
from skylight.inverse._descent import (
    Iterates,
    Stage,
    descend,
    deviation_weights,
    deviations,
    deviations_apart,
)
from skylight.inverse._faces import (
    FaceTerm,
    Level,
    LitFaces,
    ObjectiveWeights,
    ScannedFace,
    data_term,
)
from skylight.inverse._gauss_newton import charbonnier
from skylight.inverse._objective import LightObjective
from skylight.inverse._solution import _Minimum, log_evidence
from skylight.models._lamps import LampsLight, LampsPrior
from skylight.sphere._frame import DirectionGrid
from skylight.transport._background import Background
from skylight.transport._matrix import TransportMatrix
from tests.inverse.test_evidence import sampled, under_a_lamp
from tests.inverse.test_linearised import check
from tests.inverse.test_objective import MODEL, ROWS, normal, observation

pytestmark = pytest.mark.usefixtures("double")
GRID = DirectionGrid.latlong(2 * ROWS)
AHEAD = [2, 3, 4, 5]  # rows of the grid, and columns a little to either side of its centre
SPREADS = BackgroundSpreads()


def background(radiance=None, *, clipped=(), contrast=1.0):
    """One block for each of 4 x 4 cells before the camera."""
    columns = torch.arange(ROWS * 4)[ROWS * 2 - 2 : ROWS * 2 + 2]
    cells = [row * ROWS * 4 + int(column) for row in AHEAD for column in columns]
    over = torch.zeros(16, dtype=torch.bool)
    over[list(clipped)] = True
    return Background(
        radiance=torch.ones(16, 3) if radiance is None else radiance,
        averages=TransportMatrix(matrix=torch.eye(len(GRID))[cells], grid=GRID),
        clipped=over,
        contrast=contrast,
    )


def term(**options):
    grey = options.pop("grey", False)
    return BackgroundTerm.of(background(**options), sphere=True, grey=grey)


def rows(term, seen):
    """In standard deviations."""
    return BEND / math.sqrt(1e-6) * term.deviation(seen)


def covariance(places):
    """Of e (16, 3), block by block, written out."""
    x, y = places.T
    shared = torch.ones(16, 16)
    mean = SPREADS.level**2 * shared + SPREADS.detail**2 * torch.eye(16)
    mean += SPREADS.shape**2 * (torch.outer(x, x) + torch.outer(y, y))
    colour = SPREADS.colour**2 * shared + SPREADS.hue**2 * torch.eye(16)
    grey, rest = torch.ones(3, 3), torch.eye(3) - torch.ones(3, 3) / 3
    return torch.kron(mean, grey) + torch.kron(colour, rest)


def test_what_was_seen_costs_nothing_and_light_twice_as_bright_its_level():
    one = term()
    lights = torch.ones(2, len(GRID), 3) * torch.tensor([1.0, 2.0])[:, None, None]
    seen = one.seen(lights, torch.zeros(2, 3))
    assert torch.allclose(seen[1], torch.full((16, 3), 2.0))
    here, twice = one.cost(one.deviation(seen))
    assert float(here.abs()) < 1e-9
    # one number that is off by log 2 of a variance that all blocks tell of together
    off = math.log(2.02 / 1.02)
    variance = SPREADS.level**2 + SPREADS.detail**2 / 16
    squares = rows(one, seen)[1].square().sum()
    assert float(squares) == pytest.approx(off**2 / variance, rel=1e-6)
    assert float(twice) > 0.3 * float(squares)


def test_rows_are_whitened_errors():
    """Their squares add up to the Mahalanobis distance by the covariance, written out."""
    one = term()
    towards = background().averages.matrix @ GRID.directions
    places = towards[:, :2] / -towards[:, 2:]
    places = places / places.abs().amax(0)
    seen = torch.rand(16, 3, generator=torch.Generator().manual_seed(1)) + 0.5
    off = ((seen + 0.02) / 1.02).log().flatten()
    expected = off @ torch.linalg.solve(covariance(places), off)
    assert float(rows(one, seen).square().sum()) == pytest.approx(float(expected), rel=1e-6)


def test_what_is_clipped_is_a_lower_bound():
    """Brighter than white costs nothing there, and other blocks count as they did without."""
    clipped, alone = term(clipped=(3, 7)), term()
    seen = torch.ones(3, 16, 3)
    seen[0, [3, 7]], seen[1, [3, 7]] = 5.0, 0.2
    cost = clipped.cost(clipped.deviation(seen))
    assert float(cost[0]) == pytest.approx(float(cost[2]), abs=1e-9) == 0
    assert float(cost[1]) > 2
    assert float(alone.cost(alone.deviation(seen))[0]) > 2
    assert rows(clipped, seen).shape[1] == 16 + 2 * 14


def test_all_of_it_clipped_or_grey():
    white = term(clipped=range(16))
    assert rows(white, torch.full((16, 3), 9.0)).abs().max() == 0
    assert rows(white, torch.full((16, 3), 0.5)).max() < 0
    grey = term(grey=True)
    coloured = torch.ones(16, 3) * torch.tensor([2.0, 1.0, 0.2])
    coloured /= coloured @ torch.tensor([0.2126, 0.7152, 0.0722])[:, None]
    assert float(rows(grey, coloured).abs().max()) < 1e-3


def test_an_implausible_background_costs_little_more_than_an_unlikely_one():
    """A black room behind a face in the sun: its pull vanishes, so it cannot make the light."""
    one = term()
    factors = torch.tensor([1.0, 2.0, 8.0, 64.0, 4096.0])[:, None, None]
    deviation = one.deviation(torch.ones(5, 16, 3) * factors)
    cost, trust = one.cost(deviation), one.trust(deviation)
    assert (trust.diff() < 0).all()
    assert float(trust[0]) == 1
    generator = torch.Generator().manual_seed(0)
    wild = one.deviation(torch.exp(6 * torch.randn(16, 3, generator=generator)))
    assert float(one.trust(wild)) < 0.1
    assert float(one.cost(wild)) < 4 * len(wild)
    assert (cost.diff() > 0).all()


def test_an_even_background_tells_less_of_level_and_colour():
    lively, even = term(), term(contrast=0.0)
    seen = torch.full((16, 3), 3.0) * torch.tensor([1.3, 1.0, 0.8])
    each = [float(one.cost(one.deviation(seen))) for one in (lively, even)]
    assert each[1] < 0.3 * each[0]


def objective(seen=None, *, model=None, photos=1, weight=1.0, **options):
    """Of as many faces, each in a photograph with a background."""
    seen = replace(seen or observation(), background=background(**options))
    sphere = model is None
    faces = [replace(FaceTerm.of(seen, sphere=sphere), photo=k) for k in range(photos)]
    return LightObjective(
        faces,
        model or LampsLight(1, 2 * ROWS),
        LampsPrior(1) if sphere else normal(9),
        normal(3),
        ObjectiveWeights(background=weight),
    )


def test_its_slopes_are_those_of_automatic_differentiation():
    radiance = torch.rand(16, 3, generator=torch.Generator().manual_seed(2)) + 0.2
    check(objective(radiance=radiance, photos=2, clipped=(1, 5)))
    check(objective(radiance=radiance, model=MODEL))
    check(objective(replace(observation(), grey=True), radiance=radiance, clipped=(1, 5)))


def test_rows_and_weights_are_the_tangent_of_the_objective():
    """At the point they belong to they have its slope, and lie above it elsewhere.

    With two faces that deviate by more than is expected, whose costs are logarithms.
    """
    one = objective(
        radiance=torch.rand(16, 3, generator=torch.Generator().manual_seed(2)) + 0.2, photos=2
    )
    one.weights = replace(one.weights, noise_of_face=True)
    generator = torch.Generator().manual_seed(3)
    here, there = (0.5 * torch.randn(1, one.size, generator=generator) for _ in range(2))
    off, _ = deviations_apart(one, here)
    count = off.shape[1]
    weights = deviation_weights(one, here)
    assert float(one.scale_of_noise(off).min()) > 1.2

    def bound(free):
        return (charbonnier(deviations(one, free)) * weights).sum()

    def cost(free):
        terms = one.terms(free)
        return (terms["data"] + terms["background"]).sum()

    slopes = [torch.autograd.functional.jacobian(each, here) for each in (bound, cost)]
    assert torch.allclose(*slopes, atol=1e-6 * float(slopes[1].abs().max()))
    assert float(cost(there) - cost(here)) < float(bound(there) - bound(here))
    assert float(weights[:, count:].max()) <= ROW_WEIGHT


def test_a_face_that_deviates_as_expected_counts_as_if_that_were_known():
    """And one that deviates e times as much costs as many nats as there are observations more."""
    known = ObjectiveWeights()
    learnt = replace(known, noise_of_face=True)
    share = torch.full((1, 20, 1), 1 / 60)
    for scale in (0.1, 0.99):
        gap = torch.full((1, 20, 3), scale * known.noise)
        assert torch.equal(data_term(gap, share, known), data_term(gap, share, learnt))
    costs = [
        float(data_term(torch.full((1, 20, 3), by * known.noise), share, learnt))
        for by in (1.0, math.e)
    ]
    assert costs[1] - costs[0] == pytest.approx(known.independent, rel=1e-3)


def test_without_weight_or_background_the_objective_is_what_it_was():
    seen, free = observation(), None
    values = []
    for one in (
        LightObjective(
            [FaceTerm.of(seen, sphere=True)],
            LampsLight(1, 2 * ROWS),
            LampsPrior(1),
            normal(3),
            ObjectiveWeights(),
        ),
        objective(seen, weight=0.0),
    ):
        free = torch.linspace(-1, 1, one.size)[None] if free is None else free
        assert "background" not in one.terms(free)
        values.append(one(free))
    assert torch.equal(*values)


def test_faces_of_one_photograph_share_its_background_in_its_units():
    seen = observation()
    bright = replace(seen, pixels=3 * seen.pixels)
    faces = LitFaces()
    for one, behind in ((seen, background(torch.full((16, 3), 0.8))), (bright, None)):
        mean = one.mean_luminance
        one = replace(one, background=behind).scaled(1 / mean)
        term = FaceTerm.of(one, sphere=True)
        faces.append(ScannedFace(photo=0, pyramid={Level(0): term}, scanned=one, mean=mean))
    terms = faces.terms(Level(0))
    made = LightObjective(terms, LampsLight(0, 2 * ROWS), None, normal(3), ObjectiveWeights())
    (one,) = made.backgrounds.values()
    assert torch.allclose(one.radiance, torch.full((16, 3), 0.8 / faces.scales()[0]))


def test_the_level_of_light_is_the_background_s():
    """Skin may be dark in bright light or light in dim light; what stands behind tells which."""
    levels = []
    for factor in (0.4, 2.5):
        one = objective(radiance=torch.full((16, 3), factor))
        start = torch.zeros(1, one.size)
        start[:, 16:19] = torch.tensor([0.3, 0.6, 0.7])
        iterates = Iterates.starting(start, one(start))
        stage = Stage(level=Level(0), starts=1, iterations=8, steps="gauss-newton")
        for _ in range(2):
            (iterates,) = descend(one, [iterates], stage, 1e-6)
        parts = one.unpack(iterates.free)
        (behind,) = one.backgrounds.values()
        seen = one.camera_response(parts, 0, behind.seen(*one.radiance(parts)))
        levels.append(float(seen.mean()))
    assert levels[1] > 1.8 * levels[0]


def test_evidence_counts_what_the_background_costs_and_rules_out():
    """By the cost and its Hessian, of automatic differentiation."""
    generator, plain = torch.Generator().manual_seed(2), objective()
    x = 0.3 * torch.randn(1, plain.size, generator=generator)
    parts, (behind,) = plain.unpack(x), plain.backgrounds.values()
    seen = plain.camera_response(parts, 0, behind.seen(*plain.radiance(parts)))[0]
    seen = seen * (0.05 * torch.randn(seen.shape, generator=generator)).exp()
    both, alone = objective(radiance=seen), objective(radiance=seen, weight=0.0)

    def cost(free):
        return both.terms(free[None])["background"][0]

    of_faces = _Minimum.at(alone, x, None).hessian[0]
    told = torch.autograd.functional.hessian(cost, x[0])
    values = [torch.linalg.eigvalsh(each) for each in (of_faces + told, of_faces)]
    more, less = (each.clamp(min=1e-3).log().sum() / 2 for each in values)
    lost = float(log_evidence(alone, x) - log_evidence(both, x))
    assert float(cost(x[0])) > 1
    assert float(more - less) > 2
    assert lost == pytest.approx(float(cost(x[0]) + more - less), abs=0.3)


@pytest.mark.slow
def test_evidence_counts_the_background():
    """Laplace's approximation against importance sampling, as of faces alone."""
    alone, minimum = under_a_lamp(0.02)
    parts = alone.unpack(minimum)
    radiance = alone.camera_response(parts, 0, term().seen(*alone.radiance(parts)))[0]
    noise = torch.randn(radiance.shape, generator=torch.Generator().manual_seed(1))
    behind = BackgroundTerm.of(background(radiance * (0.3 * noise).exp()), sphere=True)
    both = LightObjective(
        [replace(alone.faces[0], background=behind)],
        alone.model,
        LampsPrior(1),
        normal(3),
        ObjectiveWeights(),
    )
    iterates = Iterates.starting(minimum, both(minimum))
    stage = Stage(level=Level(0), starts=1, iterations=40, steps="gauss-newton")
    for _ in range(2):
        (iterates,) = descend(both, [iterates], stage, 1e-9)
    found = float(log_evidence(both, iterates.free))
    assert found == pytest.approx(sampled(both, iterates.free), abs=7)
    assert found < float(log_evidence(alone, minimum)) - 3
