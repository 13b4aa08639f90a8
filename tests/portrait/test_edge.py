"""The edge that a lamp behind a person draws: where it may be, and what hair makes of it."""

import cv2
import numpy as np
import pytest

from skylight.portrait._edge import (
    MOST_STRAND,
    NEAR_HEAD,
    SHEEN,
    EdgeLight,
    known,
    leaning,
    reflected,
    surroundings,
)
from skylight.sphere._envmap import LUMINANCE

FACE_PX = 96.0
BEHIND = EdgeLight(direction=(0.58, 0.42, -0.69), strength=3.0, spread_rad=0.11)


def strands(level: float, contrast: float = 0.4) -> np.ndarray:
    """Of dark hair, linear: locks and strands as logarithmic noise along the columns."""
    rng = np.random.default_rng(5)
    fine = cv2.GaussianBlur(rng.normal(size=(200, 200)).astype(np.float32), (1, 0), 0.8, sigmaY=9)
    rough = cv2.GaussianBlur(rng.normal(size=(200, 200)).astype(np.float32), (0, 0), 2.5)
    noise = fine / fine.std() + rough / rough.std()
    colour = np.array([1.2, 0.95, 0.8], np.float32)
    return level * colour * np.exp(contrast * noise)[..., None].astype(np.float32)


def luminance(picture: np.ndarray) -> np.ndarray:
    return picture @ np.array(LUMINANCE)


@pytest.mark.parametrize("level", [0.004, 0.02, 0.2])
def test_strands_keep_their_contrast_in_the_edge(level: float) -> None:
    """Whatever the light's strength: of the light added, and of the whole picture."""
    hair = strands(level)
    around = surroundings(hair, np.ones((200, 200), np.float32), FACE_PX)
    sent = reflected(hair, around, 0.3, 0.004)
    own = np.log(luminance(hair)).std()
    for edge in (0.3, 3.0, 10.0):
        # of a sheen that is a root of what is there it would be half
        assert np.log(luminance(hair + edge * sent)).std() > 0.9 * own
    rise = np.log(luminance(sent) / luminance(hair))
    assert rise.std() < 0.5 * own  # a multiple of what is there, nearly the same all over


def test_the_sheen_is_the_surfaces_and_no_pigments() -> None:
    """Of hair ten times as dark it is the same where nothing strays, without colour."""
    brown, black = strands(0.1), strands(0.01)
    all_of_it = np.ones(brown.shape[:2], np.float32)
    sheens = [
        reflected(each, surroundings(each, all_of_it, FACE_PX), 0.3, 0.0) - each
        for each in (brown, black)
    ]
    np.testing.assert_allclose(sheens[1], sheens[0], rtol=1e-4)
    np.testing.assert_allclose(sheens[0], sheens[0][..., :1] * np.ones(3), rtol=1e-3)
    assert sheens[0].mean() == pytest.approx(SHEEN * 0.3, rel=0.05)


def test_what_is_as_dark_as_stray_light_has_a_quarter_of_the_sheen() -> None:
    """(Y / (Y + v))^2 of it where all is even, so that little is laid over what is black."""
    veil = 0.01
    for level in (0.0, 0.1 * veil, veil):
        flat = np.full((50, 50, 3), level, np.float32)
        around = surroundings(flat, np.ones((50, 50), np.float32), FACE_PX)
        sheen = reflected(flat, around, 0.3, veil) - flat
        expected = SHEEN * 0.3 * (level / (level + veil)) ** 2
        np.testing.assert_allclose(sheen, expected, rtol=1e-3, atol=1e-7)
    pale = np.full((50, 50, 3), 0.3, np.float32)
    around = surroundings(pale, np.ones((50, 50), np.float32), FACE_PX)
    assert (reflected(pale, around, 0.3, veil) - pale).min() > 0.9 * SHEEN * 0.3


def test_an_earring_in_dark_hair_has_no_more_sheen_than_a_lock() -> None:
    """It is ninety times as bright as what is around it; without a bound so would its sheen be."""
    hair = np.full((100, 100, 3), 0.01, np.float32)
    hair[50, 50] = 0.9
    around = surroundings(hair, np.ones((100, 100), np.float32), FACE_PX)
    sheen = reflected(hair, around, 0.3, 0.005) - hair
    assert around[50, 50] < 0.02
    assert sheen[50, 50].max() == pytest.approx(MOST_STRAND * SHEEN * 0.3, rel=0.01)


def test_surroundings_are_the_persons_alone() -> None:
    dark = np.full((120, 120, 3), 0.02, np.float32)
    matte = np.zeros((120, 120), np.float32)
    matte[:, :60] = 1
    matte = cv2.GaussianBlur(matte, (0, 0), 1.0)
    behind = np.where(matte[..., None] > 0.5, dark, 0.9)
    shown = matte[..., None] * dark + (1 - matte[..., None]) * behind
    around = surroundings(shown.astype(np.float32), matte, FACE_PX)
    np.testing.assert_allclose(around[:, :60], 0.02, rtol=0.1)


def disc(radius: float, middle: tuple[float, float] = (100, 100)) -> np.ndarray:
    rows, columns = np.indices((200, 200))
    return np.hypot(columns - middle[0], rows - middle[1]) < radius


def test_an_outline_is_believed_near_head_hair_and_bust_only() -> None:
    """A wall that was cut out with the head is not lit, and an ear that sticks out is."""
    none = np.zeros((200, 200), bool)
    head = disc(40)
    believed = known(head, none.astype(np.float32), none, FACE_PX)
    assert believed[disc(40 + NEAR_HEAD * FACE_PX - 1)].min() > 0.99
    assert believed[~disc(40 + (NEAR_HEAD + 0.05) * FACE_PX + 1)].max() < 0.01
    hair = known(none, 0.9 * head, none, FACE_PX)
    np.testing.assert_allclose(hair, believed, atol=1e-6)
    assert known(none, 0.1 * head, none, FACE_PX).max() == 0
    wall = head.copy()
    wall[:100, 90:140] = True  # to the picture's upper border
    sent = BEHIND.on(leaning(wall.astype(np.float32), (200, 200), FACE_PX) * believed[..., None])
    assert sent[:48].max() < 1e-3
    assert sent[100:].max() > 1
    without = BEHIND.on(leaning(wall.astype(np.float32), (200, 200), FACE_PX))
    assert without[:48].max() > 1
    assert known(none, none.astype(np.float32), disc(40), FACE_PX)[60, 130] == 1  # a shoulder's


def test_an_edge_begins_without_a_step() -> None:
    """Along a radius of a head as large as a real one is, in a picture where it is 500 high."""
    rows, columns = np.indices((700, 700))
    head = (np.hypot(columns - 300, rows - 400) < 250).astype(np.float32)
    sent = BEHIND.on(leaning(head, (700, 700), 500.0))[400, 300:549]
    (lit,) = np.nonzero(sent > 0)
    assert 150 < lit[0] < 230
    assert np.all(sent[lit[0] :] > 0)
    assert sent.max() > 5
    assert sent[lit[0] : lit[0] + 5].max() < 0.02 * sent.max()
    weak = sent[sent < 0.3 * sent.max()]  # where a cylinder's falls off, it is steep
    assert np.abs(np.diff(weak)).max() < 0.04 * sent.max()
