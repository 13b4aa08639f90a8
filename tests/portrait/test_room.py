"""White, black and borders of a photograph in a new light."""

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from skylight.portrait._gain import BRIGHTER, DARKER, DARKEST, KNEE, bounded
from skylight.portrait._room import (
    LEAST_ROOM,
    OTHER_BRIGHTER,
    OTHER_DARKER,
    OVER,
    ROUND,
    SHORT,
    VEILING,
    above_veil,
    base_of,
    below_white,
    headroom,
    light_share,
    veil_of,
)

GAINS = st.floats(-4, 4)
BRIGHTNESS = st.floats(0.005, 1.0)


def one(value: float) -> np.ndarray:
    return np.full((1, 1), value, np.float32)


@given(brightness=BRIGHTNESS, gain=GAINS, typical=GAINS)
def test_a_key_light_drives_nothing_above_white(
    brightness: float, gain: float, typical: float
) -> None:
    base = np.log(one(brightness))
    least = max(0.0, np.log(brightness) + typical)  # what the mean change itself does
    for skin, own, down in ((1, BRIGHTER, DARKER), (0, OTHER_BRIGHTER, OTHER_DARKER)):
        level = typical + float(bounded(one(gain), *headroom(base, typical, one(skin)))[0, 0])
        assert np.log(brightness) + level <= max(least, -SHORT) + LEAST_ROOM + 1e-5
        assert level <= own + max(typical, 0.0) + LEAST_ROOM + 1e-5
        assert level >= typical - down - 1e-5


def slopes(level: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Along the last axis: the first, and how fast it changes."""
    first = np.diff(level.astype(np.float64), axis=-1) / step
    return first, np.diff(first, axis=-1) / step


@pytest.mark.parametrize("typical", [-0.5, 0.0, 0.7])
@pytest.mark.parametrize("skin", [0.0, 1.0])
def test_a_gain_bends_nowhere_sharply(typical: float, skin: float) -> None:
    """Neither as the light changes nor from dark to white, where a bend is seen as a seam.

    The clipped room and the knee of its own width that were here before bent without bound along
    brightness, and by 1 in 0.07 along the gain.
    """
    steps = np.float32(0.005)
    base = np.arange(-3, 1e-6, steps, dtype=np.float32)[None]
    gain = np.arange(-3, 3, steps, dtype=np.float32)
    skins = np.full_like(base, skin)
    most, least = headroom(base, typical, skins)
    gains, mosts, leasts = np.broadcast_arrays(gain[None].astype(np.float64), most.T, least.T)
    level = bounded(gains, mosts, leasts)
    of_gain, bend = slopes(level, steps)
    assert np.abs(bend).max() < 1.01 / KNEE
    assert -1e-3 < of_gain.min() < of_gain.max() < 1.001
    of_base, bend = slopes(level.T, steps)
    assert np.abs(of_base).max() < 1.01  # so a brighter place does not become darker than another
    assert np.abs(bend).max() < 0.3 / ROUND
    # along both, as on a forehead from its lit side to its highlight
    across = np.diff(level, axis=1) / steps
    assert np.abs(np.diff(across, axis=0)).max() < 0.05


def test_a_gain_that_finds_no_room_leaves_what_is_lit_as_it_was() -> None:
    """0 stays 0, however little room there is, and what is left is still approached."""
    for most in (0.0, 0.003, 0.05, 0.2, 1.0):
        level = bounded(np.array([0.0, 9.0, 1e-3, -1e-3, -9.0], np.float64), most, DARKER)
        assert level[0] == 0
        assert level[1] == pytest.approx(most, abs=2e-4)
        # from either side with one slope, 1 where there is room
        assert level[2] == pytest.approx(-level[3], rel=0.05, abs=1e-4)
        assert level[4] < -1.9


@given(brightness=BRIGHTNESS, gain=GAINS, typical=st.floats(-1, 1))
def test_black_stays_black_and_no_gain_is_turned_round(
    brightness: float, gain: float, typical: float
) -> None:
    base, veil = np.log(one(brightness)), 0.01
    level = float(above_veil(one(gain), base, one(0), veil, typical)[0, 0])
    assert above_veil(one(gain), base, one(1), veil, typical)[0, 0] == pytest.approx(gain, abs=1e-5)
    usual = max(typical, 0.0)
    if gain <= usual:
        assert level == pytest.approx(gain, abs=1e-6)
        return
    assert usual - 1e-5 <= level <= gain + 1e-5
    # the light of the thing itself, and the veil beside it, which no lamp makes brighter
    own = max(brightness - veil, 0) * np.exp(gain) + min(veil, brightness) * np.exp(usual)
    assert brightness * np.exp(level) == pytest.approx(own, rel=1e-4)


def test_the_veil_is_a_part_of_the_mean_light() -> None:
    picture = np.zeros((8, 8, 3), np.float32)
    picture[:4] = 0.5
    assert veil_of(picture, 1.0) == pytest.approx(0.25 * VEILING)
    assert veil_of(10 * picture, 10.0) == pytest.approx(0.25 * VEILING)
    assert veil_of(100 * picture, 1.0) == pytest.approx(0.5 * VEILING)  # the sun is cut off


def test_white_stays_white_until_it_is_a_stop_and_a_half_darker() -> None:
    base, gain = (
        np.log(np.array([[1.0, 0.85, 0.7, 0.5]], np.float32)),
        np.full((1, 4), -0.8, np.float32),
    )
    none, all_ = np.zeros_like(gain), np.ones_like(gain)
    darker = below_white(gain, base, none)[0]
    assert darker[0] == 0
    assert -0.8 < darker[1] < 0
    np.testing.assert_allclose(darker[2:], -0.8)
    assert below_white(2 * gain, base, none)[0, 0] == pytest.approx(OVER - 1.6)
    np.testing.assert_array_equal(below_white(-gain, base, none), -gain)
    np.testing.assert_array_equal(below_white(gain, base, all_), gain)


def test_the_base_has_edges_and_no_texture() -> None:
    rng = np.random.default_rng(0)
    picture = np.where(np.arange(128)[:, None] < 64, 0.1, 0.8)[..., None] * np.ones((1, 128, 3))
    noisy = (picture * rng.uniform(0.95, 1.05, (128, 128, 1))).astype(np.float32)
    base = base_of(2 * noisy, 2.0, 200.0)
    want = np.log(picture[..., 0] + DARKEST)
    away = np.abs(np.arange(128) - 63.5) > 6
    assert np.abs(base - want)[away].max() < 0.03
    assert np.abs(base - want).max() < 0.15  # at the edge, which is a logarithm of 2 high
    assert base_of(np.full((16, 16, 3), 3.0, np.float32), 1.0, 50.0).max() == 0


@pytest.mark.parametrize(("person", "behind"), [(0.03, 0.9), (0.2, 0.5), (0.5, 0.1)])
def test_nothing_glows_behind_a_border(person: float, behind: float) -> None:
    """Against the person's light relit and the other's left, and against mixed logarithms.

    Before what is darker the new light is less than it should be, and nowhere more.
    """
    rows, columns = np.indices((96, 96))
    cut = (np.hypot(rows - 48, columns - 48) < 30).astype(np.float32)
    area = cv2.GaussianBlur(cut, (0, 0), 3.0)
    seen = area * person + (1 - area) * behind
    share = light_share(np.repeat(seen[..., None], 3, 2), area, 150.0)
    gain = 2.0
    ours = seen * (1 + share * (gain - 1))
    want = area * person * gain + (1 - area) * behind
    assert (ours - want).max() < 0.02  # of the person's colour where the matte is .95 for 1
    assert (want - ours).max() < 0.11
    if person < behind:
        mixed = seen * np.exp(area * np.log(gain))
        assert (mixed - want).max() > 5 * (ours - want).max()
        np.testing.assert_array_less(want - ours, 1e-3)
