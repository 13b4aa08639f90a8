"""The matte of a person."""

import cv2
import numpy as np

from skylight.faces._segmentation import person_matte

SIZE, FACE_PX = 160, 40.0


def disc(row: float, column: float, radius: float, size: int = SIZE) -> np.ndarray:
    rows, columns = np.mgrid[:size, :size] + 0.5
    return (rows - row) ** 2 + (columns - column) ** 2 < radius**2


def picture(body: np.ndarray, seed: int = 0) -> np.ndarray:
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
        picture(body), head, disc(150, 80, 45), np.zeros((SIZE, SIZE), np.float32), FACE_PX
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
    shown = picture(head | hair | other)
    shown[hair] = (30, 25, 20)
    nothing = np.zeros((SIZE, SIZE), bool)
    matte = person_matte(shown, head, nothing, hair.astype(np.float32), FACE_PX)
    assert matte[cv2.erode(hair.astype(np.uint8), np.ones((5, 5))) > 0].mean() > 0.9
    assert matte[other].max() < 0.02


def test_the_same_picture_gives_the_same_matte_at_the_size_of_the_picture() -> None:
    head = disc(60, 80, 25)
    large = cv2.resize(picture(head), (3 * SIZE, 3 * SIZE), interpolation=cv2.INTER_CUBIC)
    nothing = np.zeros((SIZE, SIZE), bool)
    hair = np.zeros((SIZE, SIZE), np.float32)
    first, second = (person_matte(large, head, nothing, hair, FACE_PX) for _ in range(2))
    assert first.shape == (3 * SIZE, 3 * SIZE)
    np.testing.assert_array_equal(first, second)
    assert ((first > 0.5) != disc(180, 240, 75, 3 * SIZE)).mean() < 0.01


def test_a_person_who_fills_the_picture() -> None:
    everywhere = np.ones((SIZE, SIZE), bool)
    matte = person_matte(
        picture(everywhere),
        everywhere,
        np.zeros_like(everywhere),
        np.zeros((SIZE, SIZE), np.float32),
        FACE_PX,
    )
    np.testing.assert_array_equal(matte, 1.0)
