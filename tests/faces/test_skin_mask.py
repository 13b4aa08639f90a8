"""Bare skin told from hair and cloth on made pictures."""

import numpy as np
import pytest

from skylight.faces._segmentation import SkinLikeness, colour_distance, roughness

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
