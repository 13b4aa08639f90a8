"""A person followed through small films: keyframes, gaps, cuts, others, turns of the camera."""

from collections.abc import Iterator, Sequence
from functools import cache

import cv2
import numpy as np
import pytest
from skimage.data import astronaut

from skylight.errors import InputError
from skylight.estimation.film._follow import Followed, Source, follow
from skylight.faces._mediapipe import MediaPipeLandmarker
from skylight.imaging._film import FilmFrame

SIDE = 256


@cache
def landmarker() -> MediaPipeLandmarker:
    return MediaPipeLandmarker()


@cache
def backdrop(seed: int = 0) -> np.ndarray:
    """Twice as wide as a picture, textured."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 215, (40, 80, 3)).astype(np.uint8)
    return cv2.resize(coarse, (2 * SIDE, SIDE), interpolation=cv2.INTER_CUBIC)


@cache
def person(height: int = 120) -> np.ndarray:
    face = astronaut()[20:200, 135:315]
    return cv2.resize(face, (height, height), interpolation=cv2.INTER_AREA)


def picture(x: int | None, *, pan: int = 0, seed: int = 0, other: int | None = None) -> np.ndarray:
    """The person ``x`` px from the left (or nobody), somebody smaller at ``other``."""
    out = backdrop(seed)[:, pan : pan + SIDE].copy()
    for left, height in ((x, 120), (other, 80)):
        if left is not None:
            out[100 : 100 + height, left : left + height] = person(height)
    return out


def followed(pictures: Sequence[np.ndarray], **options: int) -> Followed:
    def sources() -> Iterator[Source]:
        for number, codes in enumerate(pictures):
            yield Source(frame=FilmFrame(number=number, time_s=0.1 * number, codes=codes))

    return follow(sources(), "film", landmarker(), **options)


def test_the_face_is_where_it_moved_to() -> None:
    found = followed([picture(60 + 4 * k) for k in range(5)])
    assert found.frames == 5
    assert found.notes == ()
    assert [one.number for one in found.shot.keyframes] == list(range(5))
    centres = np.array([one.face.points.mean(0) for one in found.shot.keyframes])
    np.testing.assert_allclose(centres[:, 0] - centres[0, 0], 4 * np.arange(5), atol=1.5)


def test_keyframes_are_even_and_reached_by_links_of_what_pans_behind() -> None:
    """Of the links to keyframes that went, only what others hang on stays."""
    shot = followed([picture(60, pan=4 * k) for k in range(9)], most=3).shot
    assert [one.number for one in shot.keyframes] == [0, 4, 8]
    reached = {shot.first}
    for link in shot.links:
        assert link.start in reached
        reached.add(link.end)
        moved = np.median(link.after - link.before, axis=0)
        np.testing.assert_allclose(moved, [-4 * (link.end - link.start), 0], atol=0.3)
    assert {one.number for one in shot.keyframes} <= reached


def test_a_while_without_a_face_is_told() -> None:
    here, gone = [picture(60)] * 3, [picture(None)] * 8
    found = followed([*here, *gone, *here])
    assert [one.number for one in found.shot.keyframes][:3] == [0, 1, 2]
    assert found.shot.keyframes[-1].number == 13
    assert found.notes == ("no face from 0.3 to 1.3 s",) or found.notes == (
        "no face from 0.3 to 1.1 s",
    )


def test_of_shots_the_one_with_most_of_the_face_is_used() -> None:
    pictures = [picture(60)] * 2 + [picture(100, seed=1)] * 4 + [picture(None, seed=2)] * 2
    found = followed(pictures)
    assert [one.number for one in found.shot.keyframes] == list(range(2, 6))
    (cuts,) = found.notes
    assert cuts.startswith("cuts at 0.2, 0.6 s: the shot from 0.2 to 0.5 s is used")


def test_of_two_people_the_largest_or_the_one_that_is_named() -> None:
    pictures = [picture(20, other=160)] * 2
    largest = followed(pictures)
    (note,) = largest.notes
    assert note == "2 faces at 0.0 s: the largest is followed; choose by --face"
    second = followed(pictures, face=2)
    left, right = (one.shot.keyframes[-1].face.points[:, 0].mean() for one in (largest, second))
    assert left < 140 < right
    with pytest.raises(InputError, match=r"there is no face 3, only 2 found at 0\.0 s"):
        followed(pictures[:1], face=3)


def test_no_face_at_all() -> None:
    with pytest.raises(InputError, match="film: no face found in 2 frames"):
        followed([picture(None)[:96, :96]] * 2)
    with pytest.raises(InputError, match="holds no pictures"):
        followed([])


def test_frames_of_several_sizes() -> None:
    with pytest.raises(InputError, match="frame 2: 256x200 pixels, but the first has 256x256"):
        followed([picture(60), picture(60)[:200]])
