"""Finding faces in pictures, and choosing one of them."""

import importlib.metadata

import cv2
import numpy as np
import pytest
from skimage.data import astronaut

from skylight.errors import AssetError, InputError
from skylight.faces import landmarks
from skylight.faces.landmarks import (
    DetectedFace,
    FaceLandmarker,
    choose_face,
    default_landmarker,
    predictor_path,
)


@pytest.fixture(scope="module")
def found():
    return default_landmarker().detect(astronaut())


def faces(count):
    points = np.random.default_rng(0).random((68, 2))
    return [DetectedFace(points=points * (count - i), score=1.0) for i in range(count)]


def test_the_astronaut_is_found(found):
    (face,) = found
    points = face.points
    # her face, by eye: x from 170 to 280, y from 70 to 200 of 512
    assert (points.min(0) > [160, 70]).all()
    assert (points.max(0) < [285, 205]).all()
    assert 40 < face.eye_distance_px < face.size_px < 160
    right, left, nose, mouth, chin = points[[36, 45, 30, 51, 8]]
    assert right[0] < nose[0] < left[0]  # her right eye is on the picture's left
    assert max(right[1], left[1]) < nose[1] < mouth[1] < chin[1]


@pytest.mark.parametrize("factor", [2, 4])
def test_large_pictures_give_the_same_landmarks(found, factor):
    size = (512 * factor, 512 * factor)
    larger = cv2.resize(astronaut(), size, interpolation=cv2.INTER_CUBIC)
    face = max(default_landmarker().detect(larger), key=lambda f: f.score)
    off = np.linalg.norm(face.points / factor - found[0].points, axis=1)
    assert np.median(off) < 0.05 * found[0].eye_distance_px


def test_the_first_face_of_a_large_picture_is_no_fold_of_cloth(found):
    larger = cv2.resize(astronaut(), (1024, 1024), interpolation=cv2.INTER_CUBIC)
    first = default_landmarker().detect(larger)[0]
    off = np.linalg.norm(first.points / 2 - found[0].points, axis=1)
    assert np.median(off) < 0.05 * found[0].eye_distance_px


def test_small_faces_are_found_at_a_second_look(found):
    smaller = cv2.resize(astronaut(), (256, 256), interpolation=cv2.INTER_AREA)
    (face,) = default_landmarker().detect(smaller)
    off = np.linalg.norm(face.points * 2 - found[0].points, axis=1)
    assert np.median(off) < 0.1 * found[0].eye_distance_px


def test_several_faces_come_largest_first(found):
    picture = np.zeros((512, 768, 3), np.uint8)
    picture[256:, :256] = cv2.resize(astronaut(), (256, 256), interpolation=cv2.INTER_AREA)
    picture[:, 256:] = astronaut()
    crowd = default_landmarker().detect(picture)
    sizes = [face.size_px for face in crowd]
    assert sizes == sorted(sizes, reverse=True)
    np.testing.assert_allclose(crowd[0].points - [256, 0], found[0].points, atol=4)


@pytest.mark.parametrize("shape", [(1, 1, 3), (40, 300, 3), (480, 640, 3)])
def test_no_face_in_nothing(shape):
    assert default_landmarker().detect(np.zeros(shape, np.uint8)) == []
    noise = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    assert default_landmarker().detect(noise) == []


def test_the_default_is_a_landmarker_and_loads_once():
    assert isinstance(default_landmarker(), FaceLandmarker)
    assert default_landmarker() is default_landmarker()


def test_faces_are_chosen_by_number():
    three = faces(3)
    assert [choose_face(three, i, "p.jpg") for i in (1, 2, 3)] == three


@pytest.mark.parametrize("number", [0, -1, 4])
def test_a_face_that_is_not_there_is_an_error_that_tells_the_choice(number):
    with pytest.raises(InputError, match=rf"p\.jpg: there is no face {number}.*--face 1 to 3"):
        choose_face(faces(3), number, "p.jpg")


def test_no_face_at_all_is_an_error_that_tells_what_to_do():
    with pytest.raises(InputError, match=r"p\.jpg: no face found; use a picture"):
        choose_face([], 1, "p.jpg")


def test_the_predictor_is_there():
    assert predictor_path().is_file()


def test_a_missing_predictor_says_what_to_install(monkeypatch, tmp_path):
    class Empty:
        def locate_file(self, name):
            return tmp_path / name

    def nothing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    metadata = landmarks.importlib.metadata
    monkeypatch.setattr(metadata, "distribution", lambda name: Empty())
    with pytest.raises(AssetError, match="reinstall"):
        predictor_path()
    monkeypatch.setattr(metadata, "distribution", nothing)
    with pytest.raises(AssetError, match="pip install face_recognition_models"):
        predictor_path()


def test_a_face_that_is_hard_to_see_is_found_and_scored_as_such(found):
    turn = cv2.getRotationMatrix2D((225.0, 130.0), 48.0, 1.0)
    (face,) = default_landmarker().detect(cv2.warpAffine(astronaut(), turn, (512, 512)))
    assert face.score < 0 < found[0].score
    middle = turn[:, :2] @ found[0].points.mean(0) + turn[:, 2]
    assert np.linalg.norm(face.points.mean(0) - middle) < 0.5 * found[0].eye_distance_px
