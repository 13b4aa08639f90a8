"""Shots of known turns in analytic light: turns, lens, light and what cannot be told."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from skylight.errors import InputError
from skylight.probes._probe_map import ProbeMap
from skylight.probes.cameras._exposures import merge
from skylight.probes.panorama._matches import Shot, shot_of
from skylight.probes.panorama._panorama import (
    Panorama,
    aligned,
    levelled,
    panorama_of,
    rotation_to,
    stitch,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from tests.turning_camera import (
    HEAD,
    LENS,
    SUN,
    SUN_IRRADIANCE,
    SUN_RAD,
    TIMES,
    pictures,
    rippled,
    shots,
    sun_irradiance,
)
from tests.virtual_camera import expose

ROWS = 64


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(Rotation.from_matrix(a.T @ b).magnitude())


@pytest.fixture(scope="module")
def found() -> Panorama:
    return panorama_of(shots(), ROWS)


def in_true_world(panorama: Panorama) -> dict[int, np.ndarray]:
    return aligned(panorama.bundle.rotations, dict(enumerate(pictures()[0])))


def errors_outside_the_sun(probe: ProbeMap) -> np.ndarray:
    """Relative, of each pixel that was seen, four degrees or more from the sun's disc."""
    environment = probe.environment
    fine = DirectionGrid.latlong(4 * ROWS).directions.numpy()
    light = torch.from_numpy(rippled(fine).reshape(4 * ROWS, -1, 3))
    true = EnvironmentMap(radiance=light).resize(ROWS).flat.numpy()
    outside = environment.grid.directions.numpy() @ SUN < math.cos(SUN_RAD + math.radians(4))
    outside &= probe.seen.flatten().numpy() == 1
    got = environment.flat.numpy()
    return (np.abs(got - true).mean(1) / true.mean(1))[outside]


class TestFound:
    def test_turns_and_lens(self, found: Panorama) -> None:
        true, got = pictures()[0], in_true_world(found)
        assert found.left_out == ()
        assert found.by_hint == ()
        off = [angle_deg(got[k], true[k]) for k in range(len(true))]
        assert np.median(off) < 0.15
        assert max(off) < 0.4
        assert found.bundle.lens.focal_px == pytest.approx(LENS.focal_px, rel=0.01)
        assert found.bundle.lens.k1 == pytest.approx(LENS.k1, abs=0.02)
        assert found.bundle.rms_px < 0.5

    def test_its_frame_is_that_of_the_true_turns_when_levelled(self, found: Panorama) -> None:
        true = levelled(dict(enumerate(pictures()[0])))
        off = [angle_deg(found.bundle.rotations[k], true[k]) for k in true]
        assert np.median(off) < 0.2

    def test_light(self, found: Panorama) -> None:
        """Against the true world: a map's frame is its own."""
        probe = stitch(shots(), in_true_world(found), found.bundle.lens, ROWS)
        error = errors_outside_the_sun(probe)
        assert np.median(error) < 0.03
        assert np.quantile(error, 0.9) < 0.12
        lit = sun_irradiance(probe.environment)
        np.testing.assert_allclose(lit, SUN_IRRADIANCE, rtol=0.05)
        assert found.clipping is None
        # the poles are in no shot: elevations reach 45 + atan(75 / 120) = 77 degrees
        assert 0.003 < probe.unseen_share < 0.03

    @pytest.mark.slow  # test_files stitches eight bits as well
    def test_eight_bits_do_as_well(self, found: Panorama) -> None:
        where = in_true_world(found)
        probe = stitch(shots(8), where, found.bundle.lens, ROWS)
        assert np.median(errors_outside_the_sun(probe)) < 0.03
        np.testing.assert_allclose(sun_irradiance(probe.environment), SUN_IRRADIANCE, rtol=0.05)


def test_a_panorama_of_two_shots_tells_of_a_clipped_sun() -> None:
    """Both see it, from 1/256 s on; a panorama of what they see from 1/4096 s on tells of none."""
    which, rng = (8, 9), np.random.default_rng(4)
    turns = {k: pictures()[0][each] for k, each in enumerate(which)}

    def made(times: tuple[float, ...]) -> Panorama:
        seen = [[expose(pictures()[1][k], t, rng, 16, f"{t} s") for t in times] for k in which]
        some = [shot_of(f"{k}", merge(each, "srgb")) for k, each in enumerate(seen)]
        return panorama_of(some, ROWS, focal_px=LENS.focal_px, hints=turns)

    assert made(TIMES).clipping is None
    probe = made(TIMES[1:])
    assert probe.clipping is not None
    true = 2 * math.pi * (1 - math.cos(SUN_RAD))
    assert true < probe.clipping.solid_angle_sr < 2 * true
    assert probe.clipping.regions == 1
    azimuth, zenith = math.atan2(SUN[0], -SUN[2]), math.acos(SUN[1])
    assert probe.clipping.azimuth_deg == pytest.approx(math.degrees(azimuth), abs=0.5)
    assert probe.clipping.zenith_deg == pytest.approx(math.degrees(zenith), abs=0.5)
    assert max(sun_irradiance(probe.probe.environment)) < 0.5 * SUN_IRRADIANCE


@pytest.mark.slow
def test_a_sun_that_every_exposure_clips_is_told(found: Panorama) -> None:
    """Exposures from 1/256 s on: a bound, and where it is."""
    probe = panorama_of(shots(16, TIMES[1:]), ROWS, focal_px=LENS.focal_px)
    assert probe.clipping is not None
    true = 2 * math.pi * (1 - math.cos(SUN_RAD))
    assert true < probe.clipping.solid_angle_sr < 3 * true
    assert max(sun_irradiance(probe.probe.environment)) < 0.5 * SUN_IRRADIANCE


class TestHints:
    def test_shots_that_match_nothing_are_placed_by_them(self) -> None:
        """Those at the horizon, and one of an even sky above: its hint is all that tells."""
        which = [*range(8, 16), 20]
        blank = [shots()[k] for k in which]
        even = np.full_like(blank[8].radiance, 0.2)
        blank[8] = Shot(name="even", radiance=even, clipped=blank[8].clipped, width=LENS.width)
        told = {k: HEAD.told()[each] for k, each in enumerate(which)}
        with_hints = panorama_of(blank, ROWS, focal_px=LENS.focal_px, hints=told)
        assert with_hints.by_hint == (8,)
        assert angle_deg(with_hints.bundle.rotations[8], told[8]) < 0.1
        # nor may the world leave the hints' by more than their mean error
        off = [angle_deg(with_hints.bundle.rotations[k], pictures()[0][8 + k]) for k in range(8)]
        assert np.median(off) < 1.5
        without = panorama_of(blank, ROWS, focal_px=LENS.focal_px)
        assert without.left_out == (8,)
        assert without.probe.unseen_share > with_hints.probe.unseen_share + 0.001

    def test_two_groups(self) -> None:
        """Shots at azimuths 0, 45 and 90 match, and those at 180 and 225, but not one of both."""
        which = [8, 9, 10, 12, 13]
        some = [shots()[k] for k in which]
        true = [pictures()[0][k] for k in which]
        told = {k: HEAD.told()[each] for k, each in enumerate(which)}

        def made(hints: dict[int, np.ndarray]) -> Panorama:
            return panorama_of(some, ROWS, focal_px=LENS.focal_px, hints=hints)

        without = made({})
        assert (without.left_out, without.by_hint) == ((3, 4), ())
        for hints in (told, {0: told[0], 3: told[3]}):
            found = made(hints)
            assert (found.left_out, found.by_hint) == ((), ())
            got = found.bundle.rotations
            # matches, not hints that err by two degrees, tell the turn within the second group
            assert angle_deg(got[3].T @ got[4], true[3].T @ true[4]) < 0.5
        assert angle_deg(told[3].T @ told[4], true[3].T @ true[4]) > 1
        assert made({0: told[0]}).left_out == (3, 4)

    def test_hints_of_none_of_those_that_match(self) -> None:
        """The hint of a shot alone, or of the smaller group, says nothing of the others."""
        some = [shots()[k] for k in (8, 9, 10, 12, 13, 20)]
        for only in (3, 5):
            with pytest.raises(
                InputError, match=r"none of the 3 shots that match .* such as shot 8"
            ):
                panorama_of(some, ROWS, focal_px=LENS.focal_px, hints={only: HEAD.told()[only]})

    def test_a_world_without_roll_is_levelled_exactly(self) -> None:
        """Whatever frame it came in; azimuths count from the first shot, or one less steep."""
        angles = [(30.0, 20.0), (100.0, -40.0), (200.0, 60.0), (290.0, 0.0)]
        tilt = Rotation.from_rotvec([0.5, 1.0, -0.7]).as_matrix()
        got = levelled({k: tilt @ rotation_to(*each) for k, each in enumerate(angles)})
        for k, (azimuth, elevation) in enumerate(angles):
            np.testing.assert_allclose(got[k], rotation_to(azimuth - 30, elevation), atol=1e-12)

    def test_hints_turn_right_and_up(self) -> None:
        ahead = np.array([0.0, 0.0, -1.0])
        np.testing.assert_allclose(rotation_to(90.0, 0.0) @ ahead, [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(rotation_to(0.0, 90.0) @ ahead, [0, 1, 0], atol=1e-12)
        np.testing.assert_allclose(rotation_to(40.0, 30.0)[1, 0], 0, atol=1e-12)


class TestRefusals:
    def test_one_shot(self) -> None:
        with pytest.raises(InputError, match="one direction is no panorama"):
            panorama_of(shots()[:1], ROWS)

    def test_no_overlap(self) -> None:
        with pytest.raises(InputError, match="no two of 2 shots overlap"):
            panorama_of([shots()[8], shots()[12]], ROWS)

    def test_no_details(self) -> None:
        even = [
            Shot(
                name=f"{k}",
                radiance=np.full((150, 180, 3), 0.5, np.float32),
                clipped=np.zeros((150, 180), np.float32),
                width=180,
            )
            for k in range(3)
        ]
        with pytest.raises(InputError, match="too few details"):
            panorama_of(even, ROWS)

    def test_sizes(self) -> None:
        one, two = shots()[:2]
        other = Shot(
            name="b", radiance=two.radiance[:100], clipped=two.clipped[:100], width=two.width
        )
        with pytest.raises(InputError, match="b has other measures than shot 0"):
            panorama_of([one, other], ROWS)
