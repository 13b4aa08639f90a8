"""The person followed through the frames of a shot, all of them and no others."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skylight.estimation.film._estimate import FOLLOWED_A_SECOND
from skylight.estimation.film._follow import Shot, Source, follow
from skylight.estimation.film._kept import KeptFilm, read_film, write_film
from skylight.faces._mediapipe import MediaPipeLandmarker
from skylight.imaging._film import film_frames
from skylight.portrait._poses import apart, film_poses
from tests.filmed import frames, kept, written


def elsewhere(count: int) -> list[np.ndarray]:
    """Another shot, without the face."""
    coarse = np.random.default_rng(5).integers(0, 255, (8, 8, 3)).astype(np.uint8)
    return [np.kron(coarse, np.ones((32, 32, 1), np.uint8))] * count


def filmed(path: Path, pictures: Sequence[np.ndarray]) -> tuple[KeptFilm, Shot]:
    """Followed as an estimate does: 10 frames a second of 25."""
    written(path, pictures)
    sampled = film_frames(path, most_a_second=FOLLOWED_A_SECOND)
    shot = follow((Source(frame=frame) for frame in sampled), str(path), MediaPipeLandmarker()).shot
    first = shot.keyframes[0]
    film = replace(
        kept(path),
        shot=(shot.begin_s, shot.until_s),
        frames=np.array([first.number]),
        times_s=np.array([first.time_s]),
    )
    return film, shot


def test_frames_after_the_last_that_was_looked_at_are_the_shots_too(tmp_path: Path) -> None:
    film, shot = filmed(tmp_path / "film.mkv", frames(5))
    assert shot.end_s < 4 / 25 - 1e-3  # the last frame was not
    assert film_poses(film).numbers.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("before", [0, 4, 5, 6])
def test_a_shot_begins_and_ends_at_its_cuts(before: int, tmp_path: Path) -> None:
    """Whichever of the frames about them were looked at."""
    film, shot = filmed(tmp_path / "film.mkv", [*elsewhere(before), *frames(7), *elsewhere(4)])
    poses = film_poses(film)
    assert poses.numbers.tolist() == list(range(before, before + 7))
    assert poses.shares.min() == 1
    assert math.isfinite(shot.until_s)


def test_the_end_of_a_shot_is_kept(tmp_path: Path) -> None:
    for end_s in (0.52, math.inf):
        film = replace(kept(written(tmp_path / "film.mkv", frames(1))), shot=(0.2, end_s))
        write_film(tmp_path, film)
        assert read_film(tmp_path).shot == (0.2, end_s)


def test_how_far_the_face_is_in_time() -> None:
    rng = np.random.default_rng(0)
    times_s = np.sort(rng.uniform(0, 20, 60))
    seen_s = times_s[rng.uniform(size=60) < 0.3]
    expected = np.abs(times_s[:, None] - seen_s).min(1)
    np.testing.assert_array_equal(apart(times_s, seen_s), expected)


def test_of_ten_minutes_at_240_a_second_little_memory_is_needed() -> None:
    """Of all pairs it were 83 GB."""
    times_s = np.arange(144_000) / 240
    assert apart(times_s, times_s[::2]).max() == pytest.approx(1 / 240)


def test_before_the_second_face_is_seen_there_is_none(tmp_path: Path) -> None:
    film = replace(
        kept(written(tmp_path / "film.mkv", frames(2))),
        frames=np.array([1]),
        times_s=np.array([1 / 25]),
        face=2,
        shot=(0.0, math.inf),
    )
    assert film_poses(film).seen.tolist() == [False, True]
