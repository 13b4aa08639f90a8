"""The edge that a lamp behind a person draws: where it may be, and what hair makes of it."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from skylight.imaging._colour import linear_to_srgb
from skylight.portrait._edge import (
    BODY,
    CLOTH_GLOSS,
    HAIR_BODY,
    HAIR_GLOSS,
    MOST_STRAND,
    NEAR_HEAD,
    SKIN_GLOSS,
    SOON_LIT,
    WIDTH,
    EdgeLight,
    Outline,
    known,
    lamp_colour,
    leaning,
    surroundings,
    told_apart,
    uncovered,
)
from skylight.portrait._keys import KEYS, USUAL_DEG, direction_seen
from skylight.sphere._envmap import LUMINANCE

FACE_PX = 96.0
WHITE, LIT = np.ones(3, np.float32), 0.8
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


def outline_of(picture: np.ndarray, hair: float = 1.0, gloss: float = SKIN_GLOSS) -> Outline:
    """Of a picture that is the person's all over, at the size of shading."""
    size = picture.shape[:2]
    whole = np.ones(size, np.float32)
    return Outline(
        leaning=np.zeros((*size, 2), np.float32),
        around=surroundings(picture, whole, FACE_PX),
        sure=whole,
        surface=(1 - hair) * whole,
        hair=hair * whole,
        gloss=((1 - hair) * gloss + hair * HAIR_GLOSS) * whole,
    )


def sent_by(
    picture: np.ndarray, veil: float, hair: float = 1.0, shine: np.ndarray = WHITE
) -> np.ndarray:
    """What an edge of 1 adds to it."""
    outline = outline_of(picture, hair)
    edge = np.dstack([outline.surface, outline.hair])
    return outline.sent(picture, edge, shine, LIT, veil)


@pytest.mark.parametrize("level", [0.01, 0.02, 0.2])
def test_strands_have_more_contrast_in_the_edge(level: float) -> None:
    """Whatever the light's strength: of the light added, and of the whole picture."""
    hair = strands(level)
    sent = sent_by(hair, 0.002)
    own = np.log(luminance(hair)).std()
    for edge in (0.3, 3.0, 10.0):
        assert np.log(luminance(hair + edge * sent)).std() > 1.1 * own
    # path-traced strands: 0.9 to 1.5 for 0.3
    assert 1.4 * own < np.log(luminance(sent)).std() < 3 * own


def test_hair_sends_on_its_own_colour_but_for_its_gloss() -> None:
    """Of brown and black hair, and no more of what is black than of what it shows."""
    for level in (0.1, 0.01):
        hair = strands(level)
        outline = replace(outline_of(hair), gloss=np.zeros(hair.shape[:2], np.float32))
        sent = outline.sent(hair, np.dstack([outline.surface, outline.hair]), WHITE, LIT, 1e-9)
        np.testing.assert_allclose(
            sent / luminance(sent)[..., None], hair / luminance(hair)[..., None], rtol=1e-4
        )
        assert luminance(sent).mean() < 1.8 * HAIR_BODY * luminance(hair).mean()
    flat = np.full((40, 40, 3), 0.02, np.float32)
    np.testing.assert_allclose(sent_by(flat, 1e-9), HAIR_BODY * 0.02 + HAIR_GLOSS * LIT, rtol=1e-4)


def test_strands_that_are_not_shown_have_no_gloss() -> None:
    """By their contrast over that of path-traced strands, squared; cloth and skin keep theirs."""
    whole = np.ones((200, 200), np.float32)

    def glosses(picture: np.ndarray, hair: float) -> np.ndarray:
        none = 0 * whole
        return Outline.of(picture, whole, whole, whole, whole, none, hair * whole, FACE_PX).gloss

    flat = np.full((200, 200, 3), 0.02, np.float32)
    assert glosses(flat, 1.0).max() < 1e-4
    np.testing.assert_allclose(glosses(flat, 0.0), CLOTH_GLOSS, rtol=1e-5)
    means = [glosses(strands(0.05, x), 1.0).mean() for x in (0.02, 0.06, 0.1, 0.5)]
    assert np.all(np.diff(means) > 0)
    assert means[0] < 0.1 * HAIR_GLOSS
    assert means[-1] > 0.95 * HAIR_GLOSS


@pytest.mark.parametrize("colour", [(1.1, 1.0, 0.7), (0.9, 1.0, 1.2), (1.0, 1.1, 1.0)])
@pytest.mark.parametrize("gloss", [SKIN_GLOSS, CLOTH_GLOSS])
def test_gloss_is_of_the_lamps_colour_whatever_a_surfaces_own(
    gloss: float, colour: tuple[float, float, float]
) -> None:
    """And so what is added to a grey thing, photographed in light of that colour, has its hue."""
    shine = np.array(colour, np.float32) / luminance(np.array(colour)).astype(np.float32)
    for own in (np.array([0.65, 0.45, 0.3]), np.array([0.03, 0.02, 0.01]), 0.2 * shine):
        flat = (own * np.ones((40, 40, 1))).astype(np.float32)
        outline = outline_of(flat, 0.0, gloss)
        edge = np.dstack([outline.surface, outline.hair])
        sent = outline.sent(flat, edge, shine, LIT, 1e-9)
        np.testing.assert_allclose(
            sent - BODY * flat, gloss * LIT * shine * np.ones_like(flat), rtol=1e-3, atol=1e-5
        )
    np.testing.assert_allclose(sent / luminance(sent)[..., None] - shine, 0, atol=1e-5)


@given(st.floats(0.5, 1.5), st.floats(0.5, 1.5), st.floats(0.5, 1.5))
def test_a_lamp_behind_is_as_warm_as_the_light_and_never_bluer_than_white(
    red: float, green: float, blue: float
) -> None:
    """Nor more magenta: so what it adds to grey or brown hair is not lavender."""
    lamp = np.array(lamp_colour((red, green, blue)))
    assert luminance(lamp) == pytest.approx(1)
    assert lamp[2] <= lamp[0] + 1e-6
    assert lamp[0] / lamp[2] == pytest.approx(max(red / blue, 1))
    assert lamp[1] == pytest.approx(np.sqrt(lamp[0] * lamp[2]))


# Of tools.measure_rim: how far inside the outline, in faces; what skin sends of its own colour and
# of white's, and what brown and blond hair send of their own, from the rim key
DEPTHS = np.array([0.005, 0.015, 0.025, 0.035, 0.05, 0.07, 0.09, 0.115, 0.145, 0.18])
SKIN_SENDS = np.array([0.482, 0.398, 0.329, 0.284, 0.226, 0.155, 0.103, 0.056, 0.018, 0.005])
SKIN_SHINES = np.array([0.299, 0.264, 0.231, 0.178, 0.126, 0.061, 0.038, 0.017, 0.006, 0.001])
HAIR_SENDS = np.array([1.12, 2.53, 2.41, 2.36, 2.37, 2.47, 2.64, 2.12, 1.48, 0.6])


def test_the_edge_is_nearly_that_of_path_traced_skin_and_hair_and_no_more_on_hair() -> None:
    rim = direction_seen(*KEYS["rim"])
    x, y, z = rim.tolist()
    light = EdgeLight(direction=(x, y, z), strength=1.0, spread_rad=math.radians(USUAL_DEG) / 4)
    # outlines whose normals lie within a cosine of 0.8 of the lamp's side
    towards = 0.9 * np.array([x, y]) / math.hypot(x, y)
    received = light.on(np.maximum(1 - DEPTHS / WIDTH, 0)[None, :, None] * towards)[0]
    for factor, want in ((BODY, SKIN_SENDS), (SKIN_GLOSS, SKIN_SHINES)):
        off = factor * received - want
        assert np.sqrt((off**2).mean() / (want**2).mean()) < 0.22
        assert np.abs(off).max() < 0.075
    hair = HAIR_BODY * received / (received + SOON_LIT)
    assert np.all(hair[1:] < HAIR_SENDS[1:])  # the first has one place
    assert np.all(hair[1:5] > 0.7 * HAIR_SENDS[1:5])


def test_what_is_as_dark_as_stray_light_sends_little_on() -> None:
    """Y / (Y + v) of what it would."""
    veil = 0.01
    for level in (0.0, 0.1 * veil, veil, 30 * veil):
        flat = np.full((50, 50, 3), level, np.float32)
        own = level / (level + veil)
        expected = own * (BODY * level + SKIN_GLOSS * LIT)
        np.testing.assert_allclose(sent_by(flat, veil, 0.0), expected, rtol=1e-3, atol=1e-7)
        expected = own**2 * (HAIR_BODY * level + HAIR_GLOSS * LIT)
        np.testing.assert_allclose(sent_by(flat, veil), expected, rtol=1e-3, atol=1e-7)


def test_an_earring_in_dark_hair_is_no_more_than_a_lock_above_it() -> None:
    """It is ninety times as bright as what is around it; without a bound so would its factor be."""
    hair = np.full((100, 100, 3), 0.01, np.float32)
    hair[50, 50] = 0.9
    sent = sent_by(hair, 0.005)
    assert sent[50, 50].max() < 1.01 * MOST_STRAND * (HAIR_BODY * 0.9 + HAIR_GLOSS * LIT)


def scene(behind: float, cut_px: float, noise: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """(picture, matte): a disc of skin before a wall, cut out that much too large."""
    rng = np.random.default_rng(4)
    inside = cv2.GaussianBlur(disc(60).astype(np.float32), (0, 0), 0.8)[..., None]
    picture = inside * np.array([0.3, 0.2, 0.15]) + (1 - inside) * behind
    picture = picture * np.exp(noise * rng.normal(size=picture.shape))
    matte = cv2.GaussianBlur(disc(60 + cut_px).astype(np.float32), (0, 0), 1.0)
    return picture.astype(np.float32), matte


def rim_of(picture: np.ndarray, matte: np.ndarray, hair: np.ndarray | None = None) -> np.ndarray:
    """What the edge adds to a picture, linear."""
    whole = np.ones(picture.shape[:2], np.float32)
    hair = 0 * whole if hair is None else hair
    sure = told_apart(picture, matte, FACE_PX)
    outline = Outline.of(picture, matte, matte, sure, whole, whole * (1 - hair), hair, FACE_PX)
    edge = matte[..., None] * outline.lit(BEHIND)
    return outline.sent(picture, edge, WHITE, LIT, 1e-3)


@pytest.mark.parametrize("behind", [0.02, 0.6])
@pytest.mark.parametrize("cut_px", [0.0, 3.0])
def test_the_edge_leaves_what_is_behind_to_one_code(behind: float, cut_px: float) -> None:
    """Also where the person was cut out by 3 % of the face's height too large: the edge begins
    where the person does."""
    picture, matte = scene(behind, cut_px)
    added = rim_of(picture, matte)

    def codes(x: np.ndarray) -> np.ndarray:
        return 255 * linear_to_srgb(torch.from_numpy(x).clamp(0, 1)).numpy()

    off = codes(picture + added) - codes(picture)
    assert np.abs(off[~disc(62.5)]).max() < 1
    assert off[disc(58)].max() > 40


def test_the_edges_energy_falls_with_what_tells_person_and_background_apart() -> None:
    """To nearly nothing where the two look the same: there the cut is chance."""
    inside = luminance(scene(0.0, 0.0)[0])[100, 100]
    energies = []
    for ratio in (0.2, 0.8, 0.9, 0.97, 1.0):
        picture, matte = scene(ratio * inside, 0.0)
        # grey skin, which only its brightness tells from the wall
        grey = (luminance(picture)[..., None] * np.ones(3)).astype(np.float32)
        energies.append(luminance(rim_of(grey, matte))[disc(60)].sum())
    assert np.all(np.diff(energies)[:-1] < 0)
    assert energies[-1] < 0.01 * energies[0]


def test_skin_behind_hair_is_not_lit() -> None:
    """A forehead beside a curtain of hair, which lies between it and the lamp."""
    picture, matte = scene(0.6, 0.0)
    rows, columns = np.indices((200, 200))
    curtain = (np.hypot(columns - 100, rows - 100) > 55) & (columns > 100)
    picture[curtain & disc(60)] = 0.02
    lit, bare = rim_of(picture, matte, curtain.astype(np.float32)), rim_of(*scene(0.6, 0.0))
    skin = disc(52) & (columns > 140) & (rows < 90)
    assert bare[skin].max() > 0.05
    assert lit[skin].max() < 0.05 * bare[skin].max()


def test_no_light_in_the_hollow_between_neck_and_shoulder() -> None:
    """Which faces neither the lamp: little beside a right angle, and all farther along."""
    matte = np.zeros((300, 300), np.float32)
    matte[:, 100:150] = 1
    matte[200:] = 1
    level, _ = uncovered(matte, np.ones_like(matte), np.zeros_like(matte), FACE_PX)
    assert level[198:202, 145:149].max() < 0.3
    assert level[100, 148] > 0.9
    assert level[202, 250] > 0.9


def test_an_outline_within_what_the_model_takes_for_the_person_is_none() -> None:
    """As between a jumper and an open coat, which was cut away."""
    none = np.zeros((200, 200), np.float32)
    bust, cut = disc(80), disc(50).astype(np.float32)
    around = np.abs(np.hypot(*(np.indices((200, 200)) - 100)) - 50) < 2
    believed = known(disc(10), none, bust, cut, FACE_PX)
    assert believed[around].max() < 0.1
    fits = known(disc(10), none, disc(51), cut, FACE_PX)
    assert fits[around].min() > 0.6


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
    no = none.astype(np.float32)
    believed = known(head, no, none, head.astype(np.float32), FACE_PX)
    assert believed[disc(40 + NEAR_HEAD * FACE_PX - 1)].min() > 0.99
    assert believed[~disc(40 + (NEAR_HEAD + 0.05) * FACE_PX + 1)].max() < 0.01
    hair = known(none, 0.9 * head, none, head.astype(np.float32), FACE_PX)
    whole = np.ones((200, 200), np.float32)
    np.testing.assert_allclose(hair, known(head, no, none, whole, FACE_PX), atol=1e-6)
    assert known(none, 0.1 * head, none, no, FACE_PX).max() == 0
    wall = head.copy()
    wall[:100, 90:140] = True  # to the picture's upper border
    sent = BEHIND.on(leaning(wall.astype(np.float32), FACE_PX) * believed[..., None])
    assert sent[:48].max() < 1e-3
    assert sent[100:].max() > 0.3
    without = BEHIND.on(leaning(wall.astype(np.float32), FACE_PX))
    assert without[:48].max() > 0.3
    assert known(none, no, disc(40), whole, FACE_PX)[60, 130] == 1  # a shoulder's


def test_an_edge_begins_without_a_step() -> None:
    """Along a radius of a head as large as a real one is, in a picture where it is 500 high."""
    rows, columns = np.indices((700, 700))
    head = (np.hypot(columns - 300, rows - 400) < 250).astype(np.float32)
    sent = BEHIND.on(leaning(head, 500.0))[400, 300:549]
    (lit,) = np.nonzero(sent > 0)
    assert 150 < lit[0] < 230
    assert np.all(sent[lit[0] :] > 0)
    assert sent.max() > 0.4
    assert sent[lit[0] : lit[0] + 5].max() < 0.02 * sent.max()
    weak = sent[sent < 0.3 * sent.max()]  # where a cylinder's falls off, it is steep
    assert np.abs(np.diff(weak)).max() < 0.04 * sent.max()
