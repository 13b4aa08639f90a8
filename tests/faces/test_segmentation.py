"""Bare skin and the matte of a person on made pictures, and hair on a photograph."""

import cv2
import numpy as np
import pytest
import torch
from skimage.data import astronaut

from skylight.faces._blazeface import Square
from skylight.faces._segmentation import (
    SkinLikeness,
    colour_distance,
    hair_probability,
    person_matte,
    roughness,
)
from skylight.imaging._colour import srgb_to_linear

SKIN = np.array([0.4, 0.25, 0.18])
SIZE = 40
FACE = np.zeros((SIZE, SIZE), dtype=bool)
FACE[20:] = True
PART = np.zeros((SIZE, SIZE), dtype=bool)
PART[2:19] = True
HEAD = np.ones((SIZE, SIZE), dtype=bool)


def picture(colour, *, rough=0.0, line=None):
    """Skin with a shade from left to right below, something of ``colour`` above."""
    rng = np.random.default_rng(3)
    image = np.where(FACE[..., None], SKIN, colour) * np.linspace(0.5, 1.5, SIZE)[None, :, None]
    image *= np.exp(0.02 * rng.normal(size=(SIZE, SIZE, 3)))
    image[:20] *= np.exp(rough * rng.normal(size=(20, SIZE, 1)))
    if line is not None:
        image[line] *= 0.3
    return image


def used(image, darkest=0.3, clipped=None):
    clipped = np.zeros_like(FACE) if clipped is None else clipped
    return SkinLikeness.of(image, FACE, clipped).bare(HEAD, PART, darkest)


def test_skin_goes_on_across_the_border():
    assert used(picture(SKIN))[PART].mean() > 0.9
    assert not used(picture(SKIN))[~PART].any()


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_light_and_shade_are_no_reason(factor):
    # a border of shadow is an edge, so it runs through the part's middle
    image = picture(SKIN)
    image[:5] *= factor
    assert used(image)[8:18].mean() > 0.9


@pytest.mark.parametrize(
    "image",
    [
        picture(SKIN * [1.0, 1.4, 2.5]),  # blue cloth
        picture(SKIN, rough=0.4),  # hair of skin's colour
        picture(SKIN * 0.1),  # black hair of skin's hue
        picture(SKIN, line=slice(18, 20)),  # cut off by a dark edge
    ],
    ids=["colour", "rough", "dark", "cut off"],
)
def test_what_is_not_skin_is_not_used(image):
    assert not used(image).any()


def test_less_than_half_of_a_part_is_chance():
    image = picture(SKIN)
    image[:11] *= [1.0, 1.4, 2.5]
    assert not used(image).any()


def test_a_part_out_of_sight_is_empty():
    likeness = SkinLikeness.of(picture(SKIN), FACE, np.zeros_like(FACE))
    assert not likeness.bare(HEAD, np.zeros_like(PART), 0.3).any()


def test_colour_distance_is_blind_to_brightness_and_counts_in_spreads():
    image = np.tile(SKIN, (SIZE, SIZE, 1))
    image[0] *= 7
    image[1] *= [np.exp(0.1), 1, 1]  # twice the least spread of red to green
    distance = colour_distance(image, FACE)
    np.testing.assert_allclose(distance[0], 0, atol=1e-12)
    np.testing.assert_allclose(distance[1], 2)


def test_roughness_is_zero_on_even_skin_and_grows_with_detail():
    flat = np.tile(SKIN, (SIZE, SIZE, 1))
    assert roughness(flat).max() < 1e-6
    checks = 1 + 0.2 * (np.indices((SIZE, SIZE)).sum(0) % 2)[..., None]
    assert roughness(flat * checks)[5:-5, 5:-5].min() > 0.05


def test_white_skin_goes_with_its_neighbours():
    image, clipped = picture(SKIN), np.zeros_like(FACE)
    image[2:8, :15] = 1.0
    clipped[2:8, :15] = True
    found = used(image, clipped=clipped)
    assert found[3:7, 1:14].all()
    assert found[PART & ~clipped].mean() > 0.7
    cloth = picture(SKIN * [1.0, 1.4, 2.5])
    cloth[2:8, :15] = 1.0
    assert not used(cloth, clipped=clipped).any()


SHOWN_PX, FACE_PX = 160, 40.0
NOWHERE = np.zeros((SHOWN_PX, SHOWN_PX), bool)
NO_HAIR = np.zeros((SHOWN_PX, SHOWN_PX), np.float32)


def disc(row: float, column: float, radius: float, size: int = SHOWN_PX) -> np.ndarray:
    rows, columns = np.mgrid[:size, :size] + 0.5
    return (rows - row) ** 2 + (columns - column) ** 2 < radius**2


def before_a_wall(body: np.ndarray, seed: int = 0) -> np.ndarray:
    """A brown person with darker hair before a mottled blue wall, noisy."""
    rng = np.random.default_rng(seed)
    shown = np.tile(np.array([60.0, 90.0, 150.0]), (*body.shape, 1))
    shown[body] = (190, 130, 100)
    shown += rng.normal(0, 8, shown.shape)
    return shown.clip(0, 255).astype(np.uint8)


def test_it_finds_shoulders_that_no_mask_has() -> None:
    head = disc(60, 80, 25)
    body = head | disc(90, 80, 14) | disc(150, 80, 56)
    matte = person_matte(
        before_a_wall(body),
        head,
        disc(150, 80, 45),
        NO_HAIR,
        FACE_PX,
    )
    assert matte.dtype == np.float32
    assert matte.min() >= 0
    assert matte.max() <= 1
    assert ((matte > 0.5) != body).mean() < 0.015
    inner = cv2.erode(body.astype(np.uint8), np.ones((9, 9))) > 0
    assert matte[inner].mean() > 0.98
    assert matte[cv2.dilate(body.astype(np.uint8), np.ones((15, 15))) == 0].max() < 0.02


def test_hair_belongs_to_the_person_and_other_people_do_not() -> None:
    head, hair = disc(80, 80, 25), disc(60, 80, 30) & ~disc(80, 80, 25)
    other = disc(80, 150, 10)
    shown = before_a_wall(head | hair | other)
    shown[hair] = (30, 25, 20)
    matte = person_matte(shown, head, NOWHERE, hair.astype(np.float32), FACE_PX)
    assert matte[cv2.erode(hair.astype(np.uint8), np.ones((5, 5))) > 0].mean() > 0.9
    assert matte[other].max() < 0.02


def test_the_same_picture_gives_the_same_matte_at_the_size_of_the_picture() -> None:
    head = disc(60, 80, 25)
    large = cv2.resize(
        before_a_wall(head), (3 * SHOWN_PX, 3 * SHOWN_PX), interpolation=cv2.INTER_CUBIC
    )
    first, second = (person_matte(large, head, NOWHERE, NO_HAIR, FACE_PX) for _ in range(2))
    assert first.shape == (3 * SHOWN_PX, 3 * SHOWN_PX)
    np.testing.assert_array_equal(first, second)
    assert ((first > 0.5) != disc(180, 240, 75, 3 * SHOWN_PX)).mean() < 0.01


def test_a_person_who_fills_the_picture() -> None:
    everywhere = np.ones((SHOWN_PX, SHOWN_PX), bool)
    matte = person_matte(
        before_a_wall(everywhere),
        everywhere,
        np.zeros_like(everywhere),
        NO_HAIR,
        FACE_PX,
    )
    np.testing.assert_array_equal(matte, 1.0)


AROUND = Square(centre=np.array([225.0, 135.0]), side=270.0, angle_rad=0.0)


@pytest.fixture(scope="module")
def portrait():
    return srgb_to_linear(torch.from_numpy(astronaut().copy()).float() / 255)


@pytest.fixture(scope="module")
def hair(portrait):
    return hair_probability(portrait, AROUND)


def test_her_hair_and_her_face_are_told_apart(hair):
    # by eye: rows, columns
    for rows, columns in [((30, 65), (200, 260)), ((65, 110), (160, 175))]:
        assert hair[slice(*rows), slice(*columns)].mean() > 0.9
    for rows, columns in [((85, 180), (195, 245)), ((260, 265), (130, 300))]:
        assert hair[slice(*rows), slice(*columns)].mean() < 0.1


def test_nothing_is_said_outside_of_the_square(hair, portrait):
    assert hair.shape == portrait.shape[:2]
    assert (hair[272:] == 0).all()
    assert (hair[:, :88] == 0).all()


def test_exposure_does_not_matter(hair, portrait):
    np.testing.assert_allclose(hair_probability(portrait / 16, AROUND), hair, atol=1e-3)


@pytest.mark.parametrize("quarter_turns", [1, 2])
def test_a_turned_picture_has_turned_hair(hair, portrait, quarter_turns):
    turned = torch.rot90(portrait, -quarter_turns, (0, 1)).contiguous()
    across, down = AROUND.centre - 256
    for _ in range(quarter_turns):
        across, down = -down, across
    square = Square(
        centre=np.array([across, down]) + 256,
        side=AROUND.side,
        angle_rad=np.pi / 2 * quarter_turns,
    )
    again = np.rot90(hair_probability(turned, square), quarter_turns)
    # at a square's edges the two are blended with 0 in different pixels
    assert np.abs(again - hair)[5:265, 95:355].max() < 0.05
