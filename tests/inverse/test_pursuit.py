"""Sets of lamps on a ball: those that light it are the best of their number."""

import math
from itertools import combinations

import torch
from scipy.optimize import nnls as scipy_nnls

from skylight.inverse._lamp_sets import ROWS, Pursuit
from skylight.sphere._envmap import luminance
from tests.inverse.test_lamps import lit_ball

ONE, TWO = (0.7, 0.3, 0.7), (-0.7, 0.5, 0.6)


def unit(direction):
    return torch.nn.functional.normalize(torch.tensor(direction, dtype=torch.float64), dim=0)


def farthest_deg(found, truth):
    """The least that any pairing of two sets leaves at its worst."""
    cosine = found.double() @ torch.stack([unit(one) for one in truth]).T
    nearest = torch.minimum(cosine.amax(0).min(), cosine.amax(1).min())
    return math.degrees(math.acos(min(float(nearest), 1.0)))


def test_lamps_that_light_a_ball_are_the_best_of_their_number():
    pursuit = Pursuit([lit_ball((ONE, 2.0), (TWO, 3.5))])
    alone = pursuit.best(3)
    assert alone.directions.shape == (3, 1, 3)
    assert farthest_deg(alone.directions[0], [ONE, TWO]) > 30
    one_left = float(pursuit.left.min())
    pursuit.grow()
    pairs = pursuit.best(3)
    assert farthest_deg(pairs.directions[0], [ONE, TWO]) < 14  # about a cell
    assert float(pursuit.left.min()) < 0.85 * one_left  # highlights are left


def test_energies_are_those_of_the_light():
    """A lamp's light over the ambient light: 3 / (4 pi 0.4)."""
    found = Pursuit([lit_ball((ONE, 3.0))]).best(1)
    assert abs(math.log(float(found.energies[0, 0]) / (3 / (4 * math.pi * 0.4)))) < math.log(1.3)


def test_what_is_left_is_that_of_an_active_set_method():
    seen = lit_ball((ONE, 2.0), (TWO, 3.5))
    pursuit = Pursuit([seen])
    pursuit.grow()
    coarse = seen.on_rows(ROWS).transport.matrix.double()
    half = coarse.shape[1] // 2
    ambient = coarse[:, :half].sum(1), coarse[:, half:].sum(1)
    root = seen.weights.double().sqrt()
    y = luminance(seen.pixels).double() * root
    for row in range(0, len(pursuit.sets), 4001):
        columns = torch.stack([*(coarse[:, d] for d in pursuit.sets[row].tolist()), *ambient], 1)
        _, rest = scipy_nnls((columns * root[:, None]).numpy(), y.numpy())
        torch.testing.assert_close(
            float(pursuit.left[row]), rest**2 / float(y @ y), atol=1e-8, rtol=1e-6
        )


def test_sets_are_apart_and_have_no_lamp_twice():
    pursuit = Pursuit([lit_ball((ONE, 2.0))])
    pursuit.grow()
    assert bool((pursuit.sets[:, 0] < pursuit.sets[:, 1]).all())
    assert len(pursuit.sets.unique(dim=0)) == len(pursuit.sets)
    found = pursuit.best(4).directions.double()
    for one, other in combinations(found, 2):
        assert math.degrees(math.acos(float((one @ other.T).amax(0).min()))) > 19.9


def test_faces_under_one_light_tell_together():
    """Each in its own exposure, and the sum of what either leaves."""
    seen = [lit_ball((ONE, 2.0), (TWO, 3.5)), lit_ball((ONE, 3.0))]
    both = Pursuit(seen)
    each = [Pursuit([one]).left for one in seen]
    torch.testing.assert_close(both.left, each[0] + each[1])
    brighter = Pursuit([seen[0].scaled(7.0), seen[1]])
    torch.testing.assert_close(brighter.left, both.left, atol=1e-9, rtol=1e-6)
