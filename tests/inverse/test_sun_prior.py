"""The sun by clock, place and compass: laws of its density, published positions, and its use."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.stats import vonmises

from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.inverse._estimate import estimate_light
from skylight.inverse._faces import FaceTerm, ObjectiveWeights
from skylight.inverse._objective import LightObjective
from skylight.inverse._posterior import FITTED
from skylight.inverse._scan import LIKELY, SunScan, scan_faces
from skylight.inverse._sun_prior import FLOOR, TILT_RAD, SunPart, SunPrior, sun_prior, zone_offsets
from skylight.models._bundle import load_bundle
from skylight.models._harmonic import HarmonicLight
from skylight.models.sunsky import SunSky
from skylight.skies._sun import Place
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, angle_between, angles_from_direction
from tests.inverse.test_objective import normal, parameters
from tests.inverse.test_posterior import FRONT, ball, evidence_of, light_of, posterior_of
from tests.inverse.test_shared_light import half_ball
from tests.sunny_face import direction, sunny_face

GRID = DirectionGrid.sky(64)
ROME = {"latitude_deg": 41.89, "longitude_deg": 12.49}
COMPASS = 1 / math.radians(15) ** 2


def part(azimuth_deg: float, zenith_deg: float, turn: float = COMPASS) -> SunPart:
    return SunPart(
        share=1.0,
        azimuth_rad=math.radians(azimuth_deg),
        zenith_rad=math.radians(zenith_deg),
        turn=turn,
    )


def about(azimuth_deg: float, zenith_deg: float) -> SunPrior:
    return SunPrior(parts=(part(azimuth_deg, zenith_deg),))


def known(taken: CaptureMetadata) -> SunPrior:
    prior, _ = sun_prior(taken)
    assert prior is not None
    return prior


# ---- the density


@pytest.mark.parametrize("turn", [0.0, 3.0, COMPASS, 1000.0])
@pytest.mark.parametrize("zenith_deg", [0.0, 10.0, 50.0, 80.0, 90.0])
def test_it_integrates_to_one_over_the_upper_hemisphere(zenith_deg: float, turn: float) -> None:
    one = part(40.0, zenith_deg, turn)
    total = float(one.log_density(GRID.directions).exp() @ GRID.solid_angles)
    assert total == pytest.approx(1, abs=3e-3)  # pixels of 1.4 degrees
    mixed = SunPrior(parts=(replace(one, share=0.3), replace(part(-100.0, 30.0), share=0.7)))
    for log_density in (mixed.log_density, mixed.clock_log_density):
        total = float(log_density(GRID.directions).exp() @ GRID.solid_angles)
        assert total == pytest.approx(1, abs=2e-3)


def test_without_a_heading_it_is_a_ring_at_the_suns_height() -> None:
    ring = SunPrior(parts=(part(70.0, 50.0, 0.0),))
    rows = ring.log_density(GRID.directions).reshape(64, 256)
    torch.testing.assert_close(rows, rows[:, :1].expand(-1, 256), rtol=1e-9, atol=1e-9)
    _, zenith = angles_from_direction(GRID.directions[:: len(GRID) // 64])
    assert math.degrees(float(zenith[rows[:, 0].argmax()])) == pytest.approx(50, abs=2)


def test_it_is_a_lobe_turned_by_what_the_compass_is_wrong_by() -> None:
    """The integral of the module's text, by the sum over a thousand turns."""
    one = part(40.0, 55.0, 8.0)
    directions = GRID.directions[::777]
    turns = np.linspace(-math.pi, math.pi, 1001)[:-1]
    share = torch.from_numpy(vonmises.pdf(turns, 8.0)) * (2 * math.pi / 1000)
    suns = torch.stack([direction(40.0 + math.degrees(turn), 55.0) for turn in turns])
    k = 1 / TILT_RAD**2
    lobes = k / (2 * math.pi) * torch.exp(k * (directions @ suns.T - 1))
    # so high above the horizon that nothing is cut off
    torch.testing.assert_close(one.log_density(directions).exp(), lobes @ share, rtol=1e-6, atol=0)


def test_a_lobe_and_its_spread() -> None:
    """Of a sharp heading it is von Mises-Fisher: one degree of freedom in each axis."""
    sharp = part(-30.0, 40.0, 1e5).log_density(GRID.directions).exp() * GRID.solid_angles
    cosine = GRID.directions @ direction(-30.0, 40.0)
    assert float(sharp @ (1 - cosine)) == pytest.approx(TILT_RAD**2, rel=0.01)


def test_a_share_is_kept_for_wrong_clocks() -> None:
    far = about(0.0, 40.0).log_density(direction(180.0, 80.0))
    assert float(far.exp()) == pytest.approx(FLOOR / (2 * math.pi), rel=1e-6)
    assert bool(about(0.0, 40.0).likely(direction(5.0, 42.0)[None]))
    assert not bool(about(0.0, 40.0).likely(direction(90.0, 42.0)[None]))


def test_its_slope_is_finite_and_that_of_differences() -> None:
    up = torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)
    places = torch.cat([GRID.directions[::4001], up, -direction(40.0, 90.0)[None]])
    for prior in (about(40.0, 50.0), SunPrior(parts=(part(0.0, 50.0, 0.0),)), about(0.0, 0.0)):
        assert torch.autograd.gradcheck(prior.log_density, (places.clone().requires_grad_(),))


# ---- from time, place and heading


def test_published_positions(shared_data: Path) -> None:
    """By the US Naval Observatory, all over the Earth; the camera looks north."""
    path = shared_data / "reference" / "usno_sun_positions_6259.txt"
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the collected data")
    checked = 0
    for line in path.read_text().splitlines()[::100]:
        day, clock, *numbers = line.split()
        latitude, longitude, _, azimuth_deg, zenith_deg = map(float, numbers)
        taken = CaptureMetadata(
            time=datetime.fromisoformat(f"{day}T{clock}+00:00"),
            latitude_deg=latitude,
            longitude_deg=(longitude + 180) % 360 - 180,
            heading_deg=0.0,
        )
        prior, advice = sun_prior(taken)
        if zenith_deg > 90:
            assert prior is None
            assert "below the horizon" in advice[0]
            continue
        (one,) = prior.parts
        true = direction(azimuth_deg, zenith_deg)
        told = direction(math.degrees(one.azimuth_rad), math.degrees(one.zenith_rad))
        assert math.degrees(float(angle_between(told, true))) < 0.001
        checked += 1
    assert checked > 20


def test_the_heading_turns_the_sun_into_the_cameras_frame() -> None:
    """At noon in the north the sun is in the south, and at 18 o'clock in June in the west."""
    noon, evening = datetime(2024, 6, 21, 11, 12, tzinfo=UTC), datetime(2024, 6, 21, 17, tzinfo=UTC)
    cases = [(noon, 180.0, 0.0), (noon, 0.0, 180.0), (noon, 90.0, 90.0), (evening, 270.0, 0.0)]
    for time, heading_deg, azimuth_deg in cases:
        prior = known(CaptureMetadata(time=time, heading_deg=heading_deg, **ROME))
        best = GRID.directions[prior.log_density(GRID.directions).argmax()]
        found, _ = angles_from_direction(best)
        off = (math.degrees(float(found)) - azimuth_deg + 180) % 360 - 180
        assert abs(off) < 25, (heading_deg, azimuth_deg)
    assert known(CaptureMetadata(time=noon, **ROME)).parts[0].turn == 0


def test_a_less_exact_heading_spreads_further() -> None:
    time = datetime(2024, 6, 21, 9, tzinfo=UTC)
    sharp, wide = (
        known(CaptureMetadata(time=time, heading_deg=0.0, heading_error_deg=error, **ROME))
        for error in (10.0, 20.0)
    )
    assert sharp.likely(GRID.directions).sum() < wide.likely(GRID.directions).sum()


ZONES = {
    "Rome in June": (41.9, 12.5, 6, 2),
    "Rome in January": (41.9, 12.5, 1, 1),
    "Madrid in July": (40.4, -3.7, 7, 2),
    "Madrid in December": (40.4, -3.7, 12, 1),
    "New York in August": (40.7, -74.0, 8, -4),
    "New York in January": (40.7, -74.0, 1, -5),
    "Sydney in January": (-33.9, 151.2, 1, 11),
    "Sydney in July": (-33.9, 151.2, 7, 10),
    "Buenos Aires in May": (-34.6, -58.4, 5, -3),
    "Singapore in June": (1.3, 103.8, 6, 8),
}


@pytest.mark.parametrize("name", ZONES)
def test_a_clock_without_a_zone_may_be_in_the_right_one(name: str) -> None:
    latitude_deg, longitude_deg, month, hours = ZONES[name]
    place = Place(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    shares = zone_offsets(place, month)
    assert math.fsum(shares.values()) == pytest.approx(1)
    assert shares[hours] >= 0.15
    local = datetime(2024, month, 15, 13, 30)
    facts = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "heading_deg": 20.0}
    prior, advice = sun_prior(CaptureMetadata(time=local, **facts))
    assert len(advice) == 1
    assert "no time zone" in advice[0]
    exact = local.replace(tzinfo=timezone(timedelta(hours=hours)))
    (true,) = known(CaptureMetadata(time=exact, **facts)).parts
    sun = direction(math.degrees(true.azimuth_rad), math.degrees(true.zenith_rad))
    assert bool(prior.likely(sun[None]))


def test_summer_time_is_of_the_hemispheres_own_summer() -> None:
    north, south, tropics = (
        Place(latitude_deg=latitude, longitude_deg=0.0) for latitude in (50.0, -40.0, 5.0)
    )
    assert max(zone_offsets(north, 7)) == 2 > max(zone_offsets(north, 1))
    assert max(zone_offsets(south, 1)) == 2 > max(zone_offsets(south, 7))
    assert zone_offsets(tropics, 7) == zone_offsets(tropics, 1)


def test_nothing_is_told_without_time_and_place() -> None:
    time = datetime(2024, 6, 21, 12, tzinfo=UTC)
    for taken in (
        CaptureMetadata(),
        CaptureMetadata(time=time, heading_deg=3.0),
        CaptureMetadata(**ROME),
    ):
        assert sun_prior(taken) == (None, ())


def test_a_sun_below_the_horizon_is_left_out_with_a_line() -> None:
    prior, advice = sun_prior(CaptureMetadata(time=datetime(2024, 6, 21, 0, tzinfo=UTC), **ROME))
    assert prior is None
    assert len(advice) == 1
    assert "below the horizon" in advice[0]
    # half an hour before sunrise by one zone, after it by the others
    early = known(CaptureMetadata(time=datetime(2024, 6, 21, 5, 15), **ROME))
    assert math.fsum(one.share for one in early.parts) == pytest.approx(1)
    assert 0 < len(early.parts) < len(zone_offsets(Place(**ROME), 6))


# ---- models, objective, scan


def test_models_tell_where_their_sun_is() -> None:
    towards = torch.stack([direction(130.0, 40.0), direction(-60.0, 70.0)])
    sunsky = SunSky()
    params = sunsky.starts_towards(towards)
    found = sunsky.sun_direction(params)
    torch.testing.assert_close(found, towards[:, None].expand_as(found).float())
    learnt = load_bundle().light()
    params = learnt.starts_towards(towards)[:, 0]
    told = learnt.sun_direction(params)
    for radiance, sun in zip(learnt(params), told.double(), strict=True):
        brightest = EnvironmentMap(radiance=radiance.reshape(32, 128, 3)).brightest_direction()
        assert math.degrees(float(angle_between(brightest, sun))) < 4
    assert HarmonicLight(2).sun_direction(torch.zeros(1, 27)) is None


def test_the_objective_counts_the_suns_place() -> None:
    prior = about(40.0, 50.0)
    seen = replace(half_ball(), specular=None)
    faces = [FaceTerm.of(seen), FaceTerm.of(seen)]
    model, weights = SunSky(), ObjectiveWeights()
    plain = LightObjective(faces[:1], model, normal(9), normal(3), weights)
    told = LightObjective(faces[:1], model, normal(9), normal(3), weights, [prior])
    given = tuple(one.float() for one in parameters())
    free = plain.pack(*given)
    assert "sun_prior" not in plain.terms(free)
    expected = -weights.sun_prior * prior.log_density(model.sun_direction(given[0]))
    torch.testing.assert_close(told.terms(free)["sun_prior"], expected)
    torch.testing.assert_close(told(free) - plain(free), expected, rtol=1e-3, atol=1e-2)
    # of several problems each has its own, or none
    both = LightObjective(
        [FaceTerm.together(faces)], model, normal(9), normal(3), weights, [None, prior]
    )
    problem = torch.tensor([0, 0, 1, 1, 1])
    mine = both.terms(free, problem)["sun_prior"]
    torch.testing.assert_close(mine, torch.where(problem == 1, expected, 0.0))


def test_the_objective_trusts_a_face_as_the_posterior_does() -> None:
    weights = ObjectiveWeights()
    balance = weights.independent / weights.noise * FITTED.temperature
    assert weights.sun_prior == pytest.approx(balance, rel=0.01)


def test_the_scan_also_looks_where_the_clock_says() -> None:
    faces = scan_faces([ball(light_of(FRONT, 0.6), noise=0.05)])
    prior = about(-30.0, 70.0)
    plain, told = SunScan.of(faces), SunScan.of(faces, sun_prior=prior)
    torch.testing.assert_close(told.candidates[:4], plain.candidates)
    assert bool(prior.likely(told.candidates[4:]).all())
    assert 1 <= len(told.candidates) - 4 <= LIKELY
    cosines = told.candidates @ told.candidates.T - torch.eye(len(told.candidates))
    assert float(cosines.max()) < math.cos(math.radians(12)) + 1e-9


# ---- the posterior


def told(evidence, sun_prior, estimate=None):
    return posterior_of(evidence, estimate, sun_prior=sun_prior)


def test_a_clock_that_agrees_narrows_the_region() -> None:
    evidence = evidence_of(direction(120.0, 50.0), kappa=20.0)
    alone, both = told(evidence, None), told(evidence, about(115.0, 52.0))
    assert alone.clock_wrong is None
    assert both.clock_wrong < 0.05
    assert both.region_sr < 0.6 * alone.region_sr
    assert float((both.density * both.grid.solid_angles).sum()) == pytest.approx(1)


def test_a_clock_tells_which_of_two_suns_it_is() -> None:
    evidence = evidence_of(direction(110.0, 50.0), direction(-110.0, 50.0), kappa=150.0)
    assert told(evidence, None).parts[0].share < 0.5
    found = told(evidence, about(105.0, 48.0))
    assert found.parts[0].share > 0.85
    assert float(found.parts[0].peak @ direction(110.0, 50.0)) > 0.99


def test_a_face_that_contradicts_the_clock_is_doubtful_and_keeps_its_sun() -> None:
    sun = direction(120.0, 50.0)
    evidence = evidence_of(sun, kappa=100.0)
    found = told(evidence, about(-60.0, 50.0), sun)
    assert found.clock_wrong > 0.9
    assert float(found.parts[0].peak @ sun) > 0.99
    assert found.parts[0].share > 0.8
    # of light without a sun there is nothing to contradict
    assert not told(replace(evidence, gain=0.0), about(-60.0, 50.0)).is_seen


def test_how_likely_the_clock_is_wrong_by_hand() -> None:
    """A face that says nothing leaves what was thought before."""
    flat = replace(evidence_of(FRONT), deviations=torch.zeros(1024, dtype=torch.float64))
    found = told(flat, about(0.0, 45.0))
    # but for the kernel, which spreads a little of it below the horizon
    assert found.clock_wrong == pytest.approx(FLOOR, rel=0.05)


# ---- a rendered face


def rendered(turned_deg):
    """(observation, true sun) of a person whose head is taken to look so far aside."""
    face = sunny_face(140.0, 50.0)
    turn, middle = Rotation.from_euler("y", turned_deg, degrees=True), face.truth.vertices.mean(0)
    fit = replace(face.truth, vertices=turn.apply(face.truth.vertices - middle) + middle)
    view = observe_face(face.picture, face.clipped, HeadModel.load(), fit, face_height_px=48)
    return view.observation, face.environment.brightest_direction()


def sun_error_deg(found, sun):
    return math.degrees(float(angle_between(found.sun_direction, sun)))


@pytest.mark.slow
def test_the_right_clock_brings_the_sun_nearer():
    observation, sun = rendered(16.0)
    plain = estimate_light(observation, "sunsky")
    found = estimate_light(observation, "sunsky", sun_prior=about(140.0, 50.0))
    assert sun_error_deg(plain, sun) > 4
    assert sun_error_deg(found, sun) < 0.8 * sun_error_deg(plain, sun)
    assert found.posterior.clock_wrong < 0.1
    assert found.posterior.region_sr < plain.posterior.region_sr
    assert "sun_prior" in found.terms


@pytest.mark.slow
def test_a_wrong_clock_does_not_draw_a_clear_faces_sun():
    observation, sun = rendered(0.0)
    plain = estimate_light(observation, "sunsky")
    assert sun_error_deg(plain, sun) < 4
    for opposite_heading_or_hours in ((320.0, 50.0), (310.0, 25.0)):
        prior = about(*opposite_heading_or_hours)
        found = estimate_light(observation, "sunsky", sun_prior=prior)
        assert found.verdict.direction.reason == "the face and the clock disagree"
        assert torch.equal(found.sun_direction, plain.sun_direction)
        peak = found.posterior.parts[0].peak
        assert math.degrees(float(angle_between(peak, sun))) < 8


def test_harmonics_have_a_clock_in_their_posterior_alone():
    observation = ball(light_of(FRONT, 0.6), noise=0.05)
    plain = estimate_light(observation, "sh9")
    told = estimate_light(observation, "sh9", sun_prior=about(150.0, 50.0))
    torch.testing.assert_close(told.environment.radiance, plain.environment.radiance)
    cell = int((plain.posterior.grid.directions @ FRONT).argmax())
    assert told.posterior.density[cell] > 1.5 * plain.posterior.density[cell]
