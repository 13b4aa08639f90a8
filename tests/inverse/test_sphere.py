"""Light of any place: found with its lamp, its kind of place, and no more lamps than pay."""

import math
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import pytest
import torch

from skylight.inverse._descent import Iterates
from skylight.inverse._estimate import estimate_light, light_problems
from skylight.inverse._lamp_sets import Pursuit
from skylight.inverse._lamps import LAMPS, Fitted, LampFamily, LampsProblem, as_many_as_pay
from skylight.inverse._problem import solve
from skylight.inverse._scan import scan_faces
from skylight.inverse._sphere import INDOORS, OPEN_SKY, _by_sky
from skylight.inverse._sun_prior import SunPart, SunPrior
from skylight.models._sphere import SphereLight, SpherePrior
from skylight.sphere._frame import DirectionGrid, angle_between
from skylight.transport._background import Background
from skylight.transport._matrix import TransportMatrix
from tests.inverse.test_lamps import ONE, lit_ball


def most_likely(evidence: tuple[float, ...], **options: float) -> tuple[int, list[int]]:
    """(how many lamps are chosen, which numbers were tried) for evidence of 0, 1, ... lamps."""
    tried: list[int] = []

    def fitted(count: int) -> Fitted[int]:
        tried.append(count)
        return Fitted(count=count, point=count, log_evidence=evidence[count])

    return as_many_as_pay(fitted, **options).count, tried


@pytest.mark.parametrize(
    ("evidence", "options", "expected"),
    [
        ((0.0, 20.0, 90.0, 95.0), {}, (0, [0, 1])),  # 25 nats are needed, and nobody looks further
        ((0.0, 30.0, 50.0, 95.0), {}, (1, [0, 1, 2])),
        ((0.0, 5.0, 17.0, 18.0), {"least_gain": 8.0, "patience": 2}, (2, [0, 1, 2, 3])),
        ((0.0, 5.0, 15.0, 18.0), {"least_gain": 8.0, "patience": 2}, (0, [0, 1, 2])),  # two need 16
        ((0.0, 9.0, 10.0, 26.0), {"least_gain": 8.0, "patience": 2}, (3, [0, 1, 2, 3])),
        ((0.0, -7.0, 90.0, 91.0), {"least_gain": 8.0, "patience": 2}, (2, [0, 1, 2, 3])),
        # far less likely than without: nobody waits
        ((0.0, -9.0, 90.0, 95.0), {"least_gain": 8.0, "patience": 2}, (0, [0, 1])),
        ((0.0, 9.0, 0.0, 95.0), {"least_gain": 8.0, "patience": 2}, (1, [0, 1, 2])),
        ((0.0, 9.0, 10.0, 95.0), {"fewest": 1}, (1, [1, 2])),
    ],
)
def test_lamps_pay_or_are_left_out(evidence, options, expected) -> None:
    assert most_likely(evidence, **options) == expected


def test_the_lamp_of_a_ball_is_found_and_told_of_which_kind_the_place_is() -> None:
    found = estimate_light(lit_ball((ONE, 3.0)), "sphere", device="cpu")
    assert found.lamps
    lamp = torch.nn.functional.normalize(torch.tensor(ONE, dtype=torch.float64), dim=0)
    off = math.degrees(float(angle_between(found.sun_direction, lamp)))
    assert off < 6
    assert sum(found.kinds.values()) == pytest.approx(1, abs=1e-4)
    assert list(found.kinds.values()) == sorted(found.kinds.values(), reverse=True)
    # what the ball shows, the light explains
    assert found.faces[0].residual < 0.05


def told_by_even_light(
    *lamps: tuple[tuple[float, float, float], float],
) -> tuple[SunPrior | None, int, int]:
    """What lamps in even light tell of a ball's main light, and how few and how many to try."""
    (problem,) = light_problems("sphere", device="cpu")
    assert isinstance(problem, LampsProblem)
    problem.add(lit_ball(*lamps))
    observed = [face.scanned for face in problem.faces]
    return problem._told_by(LAMPS, Pursuit(observed), scan_faces(observed, sphere=True))


def test_lamps_in_even_light_tell_where_the_main_one_is() -> None:
    told, fewest, most = told_by_even_light((ONE, 3.0), ((-0.7, 0.5, 0.6), 1.0))
    assert told is not None
    assert (fewest, most) == (1, 2)  # the second brings 20 nats
    grid = DirectionGrid.latlong(64)
    density = told.log_density(grid.directions)
    assert float(density.exp() @ grid.solid_angles) == pytest.approx(1, abs=3e-3)
    lamp = torch.nn.functional.normalize(torch.tensor(ONE, dtype=torch.float64), dim=0)
    assert math.degrees(float(angle_between(grid.directions[density.argmax()], lamp))) < 6


def test_what_the_guide_rules_out_is_not_tried() -> None:
    assert told_by_even_light((ONE, 3.0))[1:] == (1, 1)  # 137 nats, and a second one takes 7
    tried: list[int] = []
    (problem,) = light_problems("sphere", device="cpu")
    assert isinstance(problem, LampsProblem)
    fitted = problem._fitted

    def counted(family: LampFamily, count: int, *rest: Any) -> Fitted[Iterates]:
        if family is not LAMPS:
            tried.append(count)
        return fitted(family, count, *rest)

    with patch.object(problem, "_fitted", counted):
        problem.add(lit_ball((ONE, 3.0)))
        (found,) = solve([problem])
    assert tried == [1]
    assert len(found.lamps) == 1


def test_even_light_tells_nothing_and_leaves_the_estimate_as_it_is() -> None:
    assert told_by_even_light() == (None, 0, 1)
    found = []
    for guide in (None, LAMPS):
        (problem,) = light_problems("sphere", device="cpu")
        assert isinstance(problem, LampsProblem)
        problem.family = replace(problem.family, guide=guide)
        problem.add(lit_ball())
        found += solve([problem])
    alone, guided = found
    torch.testing.assert_close(alone.params, guided.params, rtol=0, atol=0)


def test_the_pictures_exposure_turns_the_odds_of_open_sky() -> None:
    def prior(exposure: float | None) -> SpherePrior:
        (problem,) = light_problems("sphere", exposures=[exposure], device="cpu")
        assert isinstance(problem, LampsProblem)
        found = problem.family.prior(0)
        assert isinstance(found, SpherePrior)
        return found

    def outdoors(prior: SpherePrior) -> float:
        mine = prior.kind == prior.kinds.index("outdoors")
        return float(prior.log_weights[mine].logsumexp(0).exp())

    dark, unknown, bright = (outdoors(prior(each)) for each in (5.0, None, 14.0))
    assert dark < 0.2 * unknown
    assert bright > 1.5 * unknown


@pytest.mark.parametrize(("place", "out"), [("outdoors", INDOORS), ("indoors", OPEN_SKY)])
def test_kinds_that_a_known_place_is_not_have_no_weight(place, out) -> None:
    (problem,) = light_problems("sphere", place=place, device="cpu")
    prior = problem.family.prior(0)
    shares = torch.zeros(len(prior.kinds)).index_add(0, prior.kind, prior.log_weights.exp())
    assert {k for k, share in zip(prior.kinds, shares, strict=True) if share == 0} == set(out)


@pytest.mark.slow
def test_a_known_place_rules_out_others() -> None:
    outdoors = estimate_light(lit_ball((ONE, 3.0)), "sphere", device="cpu", place="outdoors")
    assert sum(outdoors.kinds[kind] for kind in ("outdoors", "street")) == pytest.approx(1)


@pytest.mark.slow
def test_two_faces_in_one_light_are_one_problem() -> None:
    first = lit_ball((ONE, 3.0))
    twice = estimate_light([first, replace(first, pixels=2 * first.pixels)], "sphere", device="cpu")
    alone = estimate_light(first, "sphere", device="cpu")
    assert len(twice.faces) == 2
    off = float(angle_between(twice.sun_direction, alone.sun_direction))
    assert math.degrees(off) < 3


@pytest.mark.parametrize("count", [0, 2])
def test_places_under_the_open_sky_are_searched_by_themselves(count) -> None:
    model, prior = SphereLight(count), SpherePrior(count)
    if count == 0:
        candidates = model.starts().unflatten(0, (-1, len(model.ambient_starts())))
    else:
        towards = torch.nn.functional.normalize(torch.ones(3, count, 3, dtype=torch.float64), dim=2)
        candidates = model.starts_at(towards, torch.ones(3, count))
    groups = _by_sky(model.places, {}, candidates)
    assert sum(each.shape[1] for each in groups) == candidates.shape[1]
    for group, kinds in zip(groups, (OPEN_SKY, INDOORS), strict=True):
        latents = group[..., : model.latents].flatten(0, 1)
        off = (latents[:, None] - prior.means).norm(dim=2)
        assert float(off.amin(1).max()) < 1e-3
        assert {prior.kinds[int(k)] for k in prior.kind[off.argmin(1)]} == {*kinds}
    (group,) = _by_sky(model.places, dict.fromkeys(INDOORS, -math.inf), candidates)
    assert torch.equal(group, groups[0])


def test_plants_behind_a_face_are_outdoors_by_day_unless_the_place_is_known() -> None:
    seen = lit_ball((ONE, 3.0))
    clock = SunPrior(parts=(SunPart(share=1.0, zenith_rad=0.7),))
    averages = TransportMatrix(matrix=torch.ones(1, 2048) / 2048, grid=DirectionGrid.latlong(32))
    behind = Background(
        radiance=torch.ones(1, 3),
        averages=averages,
        clipped=torch.zeros(1, dtype=torch.bool),
        contrast=1.0,
        outdoors=True,
    )
    for place, kinds in (("auto", {"outdoors"}), ("indoors", {*INDOORS})):
        (problem,) = light_problems("sphere", place=place, sun_priors=[clock], device="cpu")
        empty = problem.another()
        problem.add(replace(seen, background=behind))
        prior = problem.family.prior(0)
        shares = torch.zeros(len(prior.kinds)).index_add(0, prior.kind, prior.log_weights.exp())
        assert {k for k, share in zip(prior.kinds, shares, strict=True) if share > 0} == kinds
        assert (problem.family is empty.family) == (place != "auto")
        assert problem.family.most == (1 if place == "auto" else 3)
        found, before = problem.faces.sun_prior, empty.faces.sun_prior
        again = problem.another()  # another photograph may be of any place
        assert (again.family, again.faces.sun_prior) == (empty.family, before)
        if place == "auto":  # what the clock says of the sun is of the main light, then
            assert found.open_sky == 1.0 > before.open_sky
        else:
            assert found is before is None
