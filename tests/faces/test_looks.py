"""Pictures in which BlazeFace looks again."""

import cv2
import numpy as np
import pytest
from skimage.data import astronaut

from skylight.faces._blazeface import Square
from skylight.faces._mediapipe import brightened, looks, mirrored, rotated

MIDDLE = Square(centre=np.array([230.0, 120.0]), side=90.0, angle_rad=0.3)


@pytest.fixture(scope="module")
def picture():
    return np.ascontiguousarray(astronaut()[:300, 40:])


def test_what_is_seen_in_a_look_is_found_in_the_picture(picture):
    """A square of the look shows what its place in the picture shows, half a grey level off."""
    for look in looks(picture):
        # a square of what is shown, about the place where MIDDLE's centre went
        centre = np.linalg.solve(look.back[:, :2], MIDDLE.centre - look.back[:, 2])
        square = Square(centre=centre, side=MIDDLE.side, angle_rad=MIDDLE.angle_rad)
        seen = square.cut(look.shown, 40, cv2.BORDER_CONSTANT).astype(np.float64)
        there = look.in_picture(square).cut(look.picture, 40, cv2.BORDER_CONSTANT)
        np.testing.assert_allclose(look.in_picture(square).centre, MIDDLE.centre, atol=1e-9)
        if np.array_equal(look.back[:, :2], np.eye(2)) and look.shown.shape == look.picture.shape:
            np.testing.assert_array_equal(seen, there)
        # turned pictures are interpolated once more; half a pixel's shift would be 4 levels
        assert np.abs(seen - there).mean() < 1.5


def test_the_picture_itself_comes_first(picture):
    first, *others = looks(picture)
    assert first.picture is first.shown is picture
    assert not first.last_resort
    assert all(look.last_resort and look.least_score < first.least_score for look in others)


def test_a_margin_is_the_mirror_image(picture):
    wide, back = mirrored(picture)
    height, width = picture.shape[:2]
    assert wide.shape == (2 * height, width + height, 3)
    np.testing.assert_array_equal(back @ [height / 2, height / 2, 1], [0, 0])
    inside = wide[height // 2 : -height // 2, height // 2 : -height // 2]
    np.testing.assert_array_equal(inside, picture)
    np.testing.assert_array_equal(wide[: height // 2], wide[height // 2 : height][::-1])


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_quarter_turns_are_exact(picture, quarter_turns):
    shown, _ = rotated(picture, 90.0 * quarter_turns)
    np.testing.assert_array_equal(shown, np.rot90(picture, -quarter_turns))


def test_brightening_raises_local_contrast_and_keeps_colour(picture):
    dark = picture // 8
    bright = brightened(dark)
    assert bright.mean() > 1.5 * dark.mean()
    assert bright.std() > 1.5 * dark.std()
    lab, before = (cv2.cvtColor(p, cv2.COLOR_RGB2LAB).astype(float) for p in (bright, dark))
    assert np.abs(lab[..., 1:] - before[..., 1:]).mean() < 1
