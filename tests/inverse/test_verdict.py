"""Three words and a sentence: every one is reached, and none contradicts the map."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.evaluation._known_faces import fitted_head, light_of, rendered_here
from skylight.inverse._posterior import SunEvidence
from skylight.inverse._result import misplaced_shading
from skylight.inverse._verdict import (
    LEVEL_FLOOR,
    LEVEL_SCALE,
    SURE_DEG,
    TINT_FLOOR,
    TINT_SCALE,
    Spreads,
    light_in_words,
    place,
    spread_of,
    verdict_of,
)
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from tests.inverse.test_posterior import CELLS, evidence_of, posterior_of, towards

GRID = DirectionGrid.latlong(64)
COS_CAP = math.cos(math.radians(15.0))
SMALL = Spreads(level=0.0, tint=0.0)


def lit(*lamps, ambient=1.0, up=0.0):
    """Ambient light, more from above by ``up``, and lamps (azimuth, zenith, kappa, share of it)."""
    light = ambient * (1 + up * GRID.directions[:, 1])
    for azimuth, zenith, kappa, energy in lamps:
        lobe = torch.exp(kappa * (GRID.directions @ towards(azimuth, zenith) - 1))
        light = light + energy * 4 * math.pi * ambient * lobe / (lobe @ GRID.solid_angles)
    return EnvironmentMap(radiance=light.reshape(64, 128, 1).repeat(1, 1, 3).float())


SUNNY = lit((140.0, 50.0, 2000.0, 2.0))


def judged(*, kappa=150.0, sun=(140.0, 50.0), environment=None, spreads=SMALL, **other):
    posterior = posterior_of(evidence_of(towards(*sun), kappa=kappa), towards(*sun))
    environment = environment or lit((*sun, 2000.0, 2.0))
    return verdict_of(environment, towards(*sun), replace(posterior, **other), spreads)


@pytest.mark.parametrize(("kappa", "word"), [(150.0, "sure"), (4.0, "rough"), (0.3, "unknown")])
def test_the_word_of_the_direction_is_the_posteriors_width(kappa, word):
    found = judged(kappa=kappa).direction
    assert found.word == word
    assert (found.within <= SURE_DEG) == (word == "sure")


def test_ninety_per_cent_of_a_lobe_lie_within():
    """Of a von Mises-Fisher lobe 1 - exp(-kappa (1 - cos r)) within r."""
    grid = DirectionGrid.sky(32)
    sun = towards(140.0, 20.0)
    posterior = posterior_of(evidence_of(sun))
    density = torch.exp(40.0 * (grid.directions @ sun - 1))
    lobe = replace(posterior, density=density / (density @ grid.solid_angles))
    found = verdict_of(SUNNY, sun, lobe, SMALL).direction.within
    assert found == pytest.approx(math.degrees(math.acos(1 - math.log(10) / 40)), abs=1.5)


@pytest.mark.parametrize(
    ("other", "word", "reason"),
    [
        ({"is_seen": False}, "unknown", "the face is lit too evenly"),
        ({"by_camera": True}, "unknown", "a flash at the camera"),
        ({"clock_wrong": 0.9}, "rough", "the face and the clock disagree"),
        ({"environment": lit()}, "unknown", "the light is even"),
        ({"environment": lit((-60.0, 50.0, 9.0, 1.0))}, "unknown", "most light comes from else"),
        ({"sun": (10.0, 70.0), "kappa": 0.3}, "unknown", "it comes from behind the face"),
    ],
)
def test_why_a_direction_is_not_sure(other, word, reason):
    found = judged(**other).direction
    assert found.word == word
    assert reason in found.reason


def test_a_flash_that_was_found_is_no_doubt():
    flash = posterior_of(evidence_of(towards(180.0, 85.0), kappa=300.0))
    found = verdict_of(
        lit((180.0, 85.0, 500.0, 1.0)), towards(180.0, 85.0), replace(flash, by_camera=True), SMALL
    )
    assert found.direction.word == "sure"
    assert found.light == "hard light from the camera"


def test_two_suns_are_told():
    suns = towards(110.0, 50.0), towards(-110.0, 50.0)
    posterior = posterior_of(evidence_of(*suns, kappa=150.0))
    both = lit((110.0, 50.0, 2000.0, 1.0), (-110.0, 50.0, 2000.0, 0.9))
    found = verdict_of(both, suns[0], posterior, SMALL).direction
    assert (found.word, found.reason) == ("unknown", "it may come from the left too")
    found = verdict_of(both, suns[1], posterior, SMALL).direction
    assert found.reason == "it may come from the right too"
    first, second = (posterior_of(evidence_of(sun), sun).density for sun in suns)
    likelier = replace(posterior, density=0.8 * first + 0.2 * second)
    found = verdict_of(both, suns[0], likelier, SMALL).direction
    assert found.word == "rough"
    assert found.reason.endswith(", but it may come from the left too")


@pytest.mark.parametrize(
    ("spread", "brightness", "colour"),
    [(0.0, "sure", "sure"), (0.08, "rough", "rough"), (1.0, "unknown", "unknown")],
)
def test_brightness_and_colour_are_sure_by_their_spreads(spread, brightness, colour):
    found = judged(spreads=Spreads(level=spread, tint=spread))
    assert (found.brightness.word, found.colour.word) == (brightness, colour)
    level = math.exp(1.645 * math.hypot(LEVEL_SCALE * spread, LEVEL_FLOOR))
    tint = math.exp(1.645 * math.hypot(TINT_SCALE * spread, TINT_FLOOR))
    assert (found.brightness.within, found.colour.within) == (
        pytest.approx(level),
        pytest.approx(tint),
    )


def test_a_background_is_named_where_it_leaves_open_what_is_asked():
    posterior = posterior_of(evidence_of(towards(140.0, 50.0)), towards(140.0, 50.0))

    def reason(level, background):
        spreads = Spreads(level=level, tint=0.0)
        sun = towards(140.0, 50.0)
        return verdict_of(SUNNY, sun, posterior, spreads, background=background).brightness.reason

    assert "background" not in reason(1.0, "unseen")
    assert "does not settle it" in reason(1.0, "used")
    assert "the background shows it" in reason(0.0, "used")
    assert "looks like other light" in reason(1.0, "doubted")


def test_the_spread_of_an_interval_gives_it_again():
    low, high = (3.0 * math.exp(sign * 1.645 * 0.2) for sign in (-1, 1))
    assert spread_of((low, high)) == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        (lit(), "even light from all around"),
        (lit(up=0.2), "even light from all around"),
        (lit(up=0.9), "soft light from above"),
        (lit((90.0, 80.0, 2000.0, 1.0)), "hard light from the right, low"),
        (lit((-140.0, 40.0, 8.0, 1.0)), "soft light from the front left, high"),
        (lit((-10.0, 95.0, 20.0, 0.2)), "soft light from behind, low"),
        # a spot many times as bright as the mean is named, however little light it is
        (lit((90.0, 60.0, 2000.0, 0.03)), "even light from all around, a glow from the right"),
        (
            lit((90.0, 60.0, 2000.0, 0.03), up=0.9),
            "soft light from above, a glow from the right",
        ),
        (
            lit((-90.0, 60.0, 2000.0, 1.0), (45.0, 70.0, 20.0, 0.5)),
            "hard light from the left; and soft light from behind on the right",
        ),
        (lit((30.0, 130.0, 2000.0, 1.0)), "hard light from behind on the right, from below"),
    ],
)
def test_the_sentence_is_the_maps(environment, words):
    told, shown = light_in_words(environment)
    assert told == words
    assert (shown == []) == words.startswith("even")
    brighter = EnvironmentMap(radiance=7.0 * environment.radiance)
    assert light_in_words(brighter)[0] == words


def test_places_to_every_side():
    assert place(torch.tensor([0.0, 0.0, 1.0])) == "from the camera"
    assert place(torch.tensor([0.0, 0.4, 0.9])) == "from the front"
    assert place(torch.tensor([-1.0, 0.4, -1.0])) == "from behind on the left"
    assert place(torch.tensor([0.0, -1.0, 0.1])) == "from below"


def test_a_black_map_is_told_of():
    black = EnvironmentMap(radiance=torch.zeros(16, 32, 3))
    assert light_in_words(black) == ("even light from all around", [])


@pytest.mark.parametrize("seed", range(24))
def test_nothing_contradicts_the_map_or_the_doubt(seed):
    """Any posterior with any map: random lamps over random light, random evidence."""
    generator = torch.Generator().manual_seed(seed)

    def drawn(low, high):
        return float(low + (high - low) * torch.rand((), generator=generator))

    lamps = [
        (drawn(-180, 180), drawn(5, 140), 10 ** drawn(0.3, 3.3), 10 ** drawn(-2, 0.5))
        for _ in range(int(drawn(0, 4)))
    ]
    environment = lit(*lamps, up=drawn(-0.9, 0.9))
    suns = [towards(drawn(-180, 180), drawn(5, 85)) for _ in range(int(drawn(1, 3.99)))]
    evidence = evidence_of(*suns, kappa=10 ** drawn(0, 2.5), gain=drawn(0.0, 0.3))
    posterior = replace(posterior_of(evidence), by_camera=drawn(0, 1) < 0.3)
    doubt = "hardly a face" if drawn(0, 1) < 0.2 else ""
    spreads = Spreads(level=drawn(0, 1), tint=drawn(0, 0.4))
    found = verdict_of(environment, suns[0], posterior, spreads, doubt=doubt)
    words = {one.word for one in (found.direction, found.brightness, found.colour)}
    if doubt:
        assert words == {"unknown"}
        assert found.summary == "unreliable: hardly a face"
        return
    if found.light.startswith("even light"):
        assert found.direction.word == "unknown"
    if found.light == "even light from all around":
        caps = (DirectionGrid.latlong(16).directions @ GRID.directions.T > COS_CAP).double()
        level = (caps * GRID.solid_angles) @ environment.flat[:, 0].double()
        assert float((level / (caps @ GRID.solid_angles)).max()) < 3.2 * float(
            environment.integrate()[0] / (4 * math.pi)
        )
    if not posterior.is_seen:
        assert found.direction.word == "unknown"
        assert "hard" not in found.light
    if found.direction.word == "sure":
        assert posterior.is_seen
        assert found.direction.within <= SURE_DEG
        shown = torch.stack(light_in_words(environment)[1])
        assert float((shown @ suns[0]).max()) >= 0.5  # within 60 degrees
    assert found.summary.startswith(f"direction {found.direction.word}, ")


def test_shading_that_is_elsewhere_is_told_from_noise():
    """Of a ramp over 20 pixels of standard deviation s, that is s / hypot(s, 0.1) of it."""
    row, column = torch.meshgrid(torch.arange(20), torch.arange(20), indexing="ij")
    places = torch.stack([row, column], 2).reshape(-1, 2)
    ramp = (1 + 0.3 * (column.flatten() - 9.5) / 9.5)[:, None].repeat(1, 3).float()
    grid = DirectionGrid.latlong(2)
    seen = Observation(
        pixels=ramp,
        weights=torch.ones(400),
        places=places,
        transport=TransportMatrix(matrix=torch.ones(400, len(grid)), grid=grid),
    )
    spread = float(ramp[:, 0].std(correction=0))
    share = spread / math.hypot(spread, 0.1)
    assert misplaced_shading(ramp, seen) == pytest.approx(0, abs=1e-6)
    assert misplaced_shading(torch.ones_like(ramp), seen) == pytest.approx(share, rel=1e-4)
    assert misplaced_shading(2 - ramp, seen) == pytest.approx(2 * share, rel=1e-4)
    checks = 0.2 * (1 - 2 * (places.sum(1) % 2))[:, None].float()
    assert misplaced_shading(ramp + checks, seen) < 0.02


def test_constant_evidence_tells_no_direction():
    flat = SunEvidence(deviations=torch.full((len(CELLS),), 0.1), gain=0.5)
    sun = direction_from_angles(*torch.tensor([2.0, 1.0]).double())
    assert verdict_of(SUNNY, sun, posterior_of(flat), SMALL).direction.word == "unknown"


@pytest.mark.slow
def test_what_is_said_of_rendered_people_holds():
    """Of four simulated suns all are within 10 degrees, three said to be for sure, and three as
    bright and red as is said."""
    held = {"direction": 0, "brightness": 0, "colour": 0}
    for number in range(4):
        face = rendered_here(46_000_000 + 2000 * number, 256)
        lit_face = light_of(face, fitted_head(face, {}), ("lamps",), {})
        found = lit_face.estimates["lamps"]
        verdict, sun = found.verdict, face.environment.brightest_direction()
        assert verdict.doubt == ""
        held["direction"] += verdict.direction.word == "sure"
        assert math.degrees(float(angle_between(found.sun_direction.double(), sun.double()))) < 10
        whole = found.environment.integrate().double(), face.environment.integrate().double()
        level = float((luminance(whole[0]) / luminance(whole[1])).log().abs())
        tint = ((whole[0] / whole[0][1]) / (whole[1] / whole[1][1])).log().abs().max()
        held["brightness"] += level <= math.log(verdict.brightness.within)
        held["colour"] += float(tint) <= math.log(verdict.colour.within)
    assert min(held.values()) >= 3
