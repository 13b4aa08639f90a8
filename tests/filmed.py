"""A film of a face whose light and head are known."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import torch

from skylight.estimation.film._kept import KeptFilm
from skylight.faces._fit import FitState
from skylight.faces._mediapipe import MediaPipeLandmarker
from skylight.imaging._edits import Edit
from skylight.imaging._film_writer import written_film
from skylight.inverse._result import Lamp
from tests.sunny_face import direction, sunny_face

FILM = Path("film.mkv")


def kept(file: Path = FILM) -> KeptFilm:
    """The film of the face in the sun, whose light and head are known, from its first frame."""
    face = sunny_face(40.0, 50.0)
    fit = face.truth
    return KeptFilm(
        environment=face.environment,
        white_balance=torch.ones(3),
        lamps=(Lamp(direction=direction(40.0, 50.0), irradiance=torch.ones(3), spread_rad=0.02),),
        edit=Edit(),
        specular_scale=0.5,
        poses=(
            FitState(
                rotation=fit.rotation,
                translation=fit.translation,
                log_focal=float(np.log(fit.camera.focal_px)),
                identity=fit.identity,
                expression=fit.expression,
            ),
        ),
        size=(256, 256),
        frames=np.array([0]),
        times_s=np.array([0.0]),
        points=landmarks()[None],
        world_from_camera=np.eye(3)[None],
        shot=(0.0, 100.0),
        face=1,
        verdict="direction good",
        advice=("taken to stand still",),
        warning="",
        file=file,
        decode=None,
    )


@cache
def landmarks() -> np.ndarray:
    (face,) = MediaPipeLandmarker().faces(sunny_face(40.0, 50.0).encoded)
    return face.points


def shift(k: int) -> np.ndarray:
    """By which frame k is moved: whole pixels, so that the truth is known exactly."""
    return np.array([(0, 0), (2, 1), (4, 1), (5, 3), (4, 4), (2, 3), (1, 1)][k % 7])


def moved(picture: np.ndarray, by: np.ndarray) -> np.ndarray:
    return np.roll(picture, (int(by[1]), int(by[0])), (0, 1))


def frames(count: int) -> list[np.ndarray]:
    """The face moved about, with noise of its own in every frame."""
    rng, codes = np.random.default_rng(0), sunny_face(40.0, 50.0).encoded
    return [
        np.clip(moved(codes, shift(k)) + rng.normal(0, 2, codes.shape), 0, 255)
        .round()
        .astype(np.uint8)
        for k in range(count)
    ]


def written(path: Path, pictures: Sequence[np.ndarray], rate: float = 25.0) -> Path:
    height, width = pictures[0].shape[:2]
    with written_film(path, rate, (width, height)) as write:
        for picture in pictures:
            write(picture)
    return path
