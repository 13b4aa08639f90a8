"""The light of pictures as they come: under a sun that is known, gaps, jumps, and units."""

import math
from functools import cache

import cv2
import numpy as np
import pytest
import torch
from jaxtyping import UInt8

from skylight.errors import InputError
from skylight.live import Light, LiveLight
from skylight.live._live import SETTLE_S, blended
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._harmonics import project
from tests.live.heads import angle_deg
from tests.sunny_face import direction, sunny_face

SUN = 50.0, 55.0  # azimuth from where the camera looks, zenith angle: behind the person, right
BESIDE = 130.0, 50.0


@cache
def face(azimuth_deg: float, zenith_deg: float) -> UInt8[np.ndarray, "h w 3"]:
    return sunny_face(azimuth_deg, zenith_deg).encoded


def moved(picture: np.ndarray, x: float, y: float, turn_deg: float = 0.0) -> np.ndarray:
    height, width = picture.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, 1.0)
    matrix[:, 2] += x, y
    return cv2.warpAffine(picture, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)


def some_light(towards: np.ndarray, time_s: float, radius_90_rad: float = 0.1) -> Light:
    return Light(
        time_s=time_s,
        direction=towards,
        radius_90_rad=radius_90_rad,
        irradiance=np.array([1.0, 0.9, 0.8]),
        ambient=np.zeros((25, 3)),
        harmonics=np.ones((9, 3)),
    )


@pytest.mark.parametrize("sun", [BESIDE, (-130.0, 40.0)])
def test_the_sun_of_a_rendered_person(sun: tuple[float, float]) -> None:
    """Of oily skin, whose highlights are not modelled: within 16 degrees, and its own radius."""
    live = LiveLight()
    for k in range(3):
        light = live.update(face(*sun), 0.1 * k)
    assert light is not None
    assert light.seen
    error = angle_deg(light.direction, direction(*sun).numpy())
    assert error < 16
    assert error < math.degrees(light.radius_90_rad)
    assert "direction" in light.words


def test_small_movements_of_a_person_do_not_move_the_light() -> None:
    live, found = LiveLight(), []
    for k in range(16):
        picture = moved(face(*BESIDE), 4 * math.sin(k), 3 * math.cos(k))
        light = live.update(picture, k / 15)
        assert light is not None
        found.append(light.direction)
    middle = np.mean(found, axis=0)
    assert max(angle_deg(one, middle) for one in found[3:]) < 4


def test_a_rolled_picture_has_a_rolled_light() -> None:
    """By 8 degrees, about where the camera looks."""
    live = LiveLight()
    first = live.update(face(*BESIDE), 0.0)
    assert first is not None
    for k in range(12):
        light = live.update(moved(face(*BESIDE), 0, 0, 8.0), 1.0 + k / 5)
    assert light is not None
    roll = math.radians(8.0)
    x, y, z = first.direction
    expected = [
        x * math.cos(roll) - y * math.sin(roll),
        x * math.sin(roll) + y * math.cos(roll),
        z,
    ]
    assert angle_deg(light.direction, np.array(expected)) < 4


def test_without_a_face_the_last_light_stays_and_says_so() -> None:
    live = LiveLight()
    nobody = np.full((256, 256, 3), 90, np.uint8)
    assert live.update(nobody, 0.0) is None
    for k in range(5):  # the detector does not look at every frame
        light = live.update(face(*BESIDE), 0.1 * k)
    assert light is not None
    assert light.seen
    after = live.update(nobody, 1.0)
    assert after is not None
    assert not after.seen
    np.testing.assert_array_equal(after.harmonics, light.harmonics)
    assert after.words == "no face is seen: this is the last light"


def test_light_that_changes_place_is_followed_at_once() -> None:
    live = LiveLight()
    for k in range(4):
        live.update(face(*BESIDE), k / 10)
    for k in range(4, 8):
        light = live.update(face(-130.0, 40.0), k / 10)
    assert light is not None
    assert angle_deg(light.direction, direction(-130.0, 40.0).numpy()) < 20


@pytest.mark.parametrize(
    "frame",
    [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)],
    ids=["grey", "float", "empty"],
)
def test_what_is_no_frame_is_refused(frame: np.ndarray) -> None:
    with pytest.raises(InputError, match="arrays of uint8"):
        LiveLight().update(frame)


def test_a_still_light_is_approached_exponentially() -> None:
    """1 - 1 / e of the way in SETTLE_S, in one step or in many."""
    towards = np.array([0.0, 0.0, 1.0])
    before, new = some_light(towards, 0.0), some_light(towards, SETTLE_S)
    new = Light(**{**vars(new), "irradiance": 2 * before.irradiance})
    whole = blended(before, new)
    share = (whole.irradiance - before.irradiance) / before.irradiance
    np.testing.assert_allclose(share, 1 - math.exp(-1), atol=1e-12)
    light = before
    for k in range(1, 11):
        light = blended(light, Light(**{**vars(new), "time_s": k * SETTLE_S / 10}))
    np.testing.assert_allclose(light.irradiance, whole.irradiance, atol=1e-12)


def test_a_far_direction_is_taken_a_near_one_is_smoothed() -> None:
    ahead, beside = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    jumped = blended(some_light(ahead, 0.0), some_light(beside, 0.1))
    assert angle_deg(jumped.direction, beside) < 0.1
    near = np.array([math.sin(0.02), 0.0, math.cos(0.02)])
    eased = blended(some_light(ahead, 0.0), some_light(near, 0.1))
    gain = angle_deg(eased.direction, ahead) / angle_deg(near, ahead)
    assert gain == pytest.approx(
        1 - math.exp(-0.1 / SETTLE_S * (1 + (0.02 / 0.0698) ** 2)), abs=0.01
    )


def test_the_map_has_the_light() -> None:
    """Harmonics of the map are those of ambient and main light, of degree 1 to 3 %."""
    rng = np.random.default_rng(2)
    towards = np.array([0.6, 0.64, 0.48])
    ambient = 0.05 * rng.standard_normal((25, 3))
    ambient[0] = 3.0
    light = Light(**{**vars(some_light(towards, 0.0)), "ambient": ambient})
    grid = DirectionGrid.latlong(16)
    radiance = torch.from_numpy(light.radiance_map().reshape(-1, 3))
    found = project(radiance, grid, 1).numpy()
    point = np.array([0.282095, *(0.488603 * towards[[1, 2, 0]])])
    expected = ambient[:4] + point[:, None] * light.irradiance
    np.testing.assert_allclose(found, expected, atol=0.03)


def test_shares_and_units() -> None:
    ambient = np.zeros((25, 3))
    ambient[0] = 2 * math.sqrt(math.pi) * 0.5  # a constant radiance of 0.5
    light = Light(
        **{
            **vars(some_light(np.array([0.0, 1.0, 0.0]), 0.0)),
            "ambient": ambient,
            "irradiance": np.full(3, math.pi / 2),
            "harmonics": ambient[:9],
        }
    )
    assert light.main_share == pytest.approx(0.5)
    assert light.mean_luminance == pytest.approx(0.5, rel=1e-4)
    facts = light.facts()
    assert len(facts["sh27"]) == 27  # type: ignore[arg-type]
    assert facts["direction"] == [0.0, 1.0, 0.0]
