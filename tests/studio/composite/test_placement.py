"""Where objects are put at first: in the picture, free of faces, as large as there is room for."""

import math

import numpy as np
import pytest

from tests.studio.composite.composite_modules import called

BALLS = {"width": 1.0, "height": 2.1, "usual": 0.11}
FOCAL, DEPTH = 1900.0, 1.0


def head(column: float, row: float) -> list[list[float]]:
    """The places of a bare head of 15 x 23 cm about a pixel."""
    scale = FOCAL / DEPTH
    x, y = np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 61))
    inside = x**2 + y**2 <= 1
    places = np.stack([column + 0.075 * scale * x[inside], row + 0.115 * scale * y[inside]], 1)
    return places.tolist()


def placed(width: int, height: int, column: float, row: float) -> tuple[dict[str, float], float]:
    """Where the balls are in a picture, and by how many metres they clear the head."""
    camera = {"focal_px": FOCAL, "width": width, "height": height, "principal": [0.0, 0.0]}
    eyes = [column * DEPTH / FOCAL, -row * DEPTH / FOCAL, -DEPTH]
    places = head(column, row)
    (found,) = called("placement", ("besideFace", camera, eyes, places, BALLS))
    assert found["foot"][2] == pytest.approx(-DEPTH)
    scale = FOCAL / DEPTH
    x, foot = scale * found["foot"][0], -scale * found["foot"][1]
    size = scale * found["size"]
    low, high = foot - size / 2, foot - 1.6 * size  # the balls' middles
    free = min(math.hypot(px - x, py - y) for y in (low, high) for px, py in places) - size / 2
    box = {"left": x - size / 2, "right": x + size / 2, "top": high - size / 2, "foot": foot}
    return box | {"size": found["size"]}, free / scale


@pytest.mark.parametrize("column", [300, 700])
def test_balls_hang_beside_the_face_in_full_size(column: int) -> None:
    box, free = placed(1000, 1000, column, 450)
    assert box["size"] == pytest.approx(0.11)
    assert 0.02 < free < 0.06
    assert box["left"] > 0
    assert box["right"] < 1000
    assert box["top"] > 0
    assert box["foot"] < 1000
    assert (box["left"] > column) == (column < 500)  # on the side with more room
    assert box["top"] < 450 < box["foot"]  # at the height of the face


def test_a_narrow_picture_gets_smaller_balls() -> None:
    box, free = placed(560, 700, 250, 350)
    assert 0.03 < box["size"] < 0.1
    assert free > 0.02
    assert box["right"] < 560


def test_a_face_that_fills_the_picture_is_covered_as_little_as_may_be() -> None:
    box, _ = placed(300, 440, 150, 220)
    assert box["size"] == pytest.approx(0.25 * 0.11)
    assert box["left"] >= 0
    assert box["right"] <= 300
    assert box["top"] < 100 or box["foot"] > 340 or not 100 < box["left"] < 200
