"""Where hair is seen."""

import numpy as np
import pytest
import torch
from skimage.data import astronaut

from skylight.faces._blazeface import Square
from skylight.faces._segmentation import hair_probability
from skylight.imaging._colour import srgb_to_linear

AROUND = Square(centre=np.array([225.0, 135.0]), side=270.0, angle_rad=0.0)


@pytest.fixture(scope="module")
def picture():
    return srgb_to_linear(torch.from_numpy(astronaut().copy()).float() / 255)


@pytest.fixture(scope="module")
def hair(picture):
    return hair_probability(picture, AROUND)


def test_her_hair_and_her_face_are_told_apart(hair):
    # by eye: rows, columns
    for rows, columns in [((30, 65), (200, 260)), ((65, 110), (160, 175))]:
        assert hair[slice(*rows), slice(*columns)].mean() > 0.9
    for rows, columns in [((85, 180), (195, 245)), ((260, 265), (130, 300))]:
        assert hair[slice(*rows), slice(*columns)].mean() < 0.1


def test_nothing_is_said_outside_of_the_square(hair, picture):
    assert hair.shape == picture.shape[:2]
    assert (hair[272:] == 0).all()
    assert (hair[:, :88] == 0).all()


def test_exposure_does_not_matter(hair, picture):
    np.testing.assert_allclose(hair_probability(picture / 16, AROUND), hair, atol=1e-3)


@pytest.mark.parametrize("quarter_turns", [1, 2])
def test_a_turned_picture_has_turned_hair(hair, picture, quarter_turns):
    turned = torch.rot90(picture, -quarter_turns, (0, 1)).contiguous()
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
