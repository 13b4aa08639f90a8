"""Finding faces in pictures, and choosing one of them."""

import importlib.metadata
import sys

import cv2
import numpy as np
import pytest
from skimage.data import astronaut

from skylight.errors import AssetError, DependencyError, InputError
from skylight.faces import _landmarkers as dlib_landmarks
from skylight.faces._landmarkers import DlibLandmarker, choose_landmarker, predictor_path
from skylight.faces._landmarks import DetectedFace, FaceLandmarker, choose_face
from skylight.faces._mediapipe import MediaPipeLandmarker


@pytest.fixture(scope="module", params=["mediapipe", "dlib"])
def landmarker(request):
    if request.param == "dlib":
        pytest.importorskip("dlib", reason="the extra dlib is not installed")
    return choose_landmarker(request.param)


@pytest.fixture(scope="module")
def found(landmarker):
    return landmarker.detect(astronaut())


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


@pytest.mark.parametrize("factor", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_large_pictures_give_the_same_landmarks(landmarker, found, factor):
    """And their first face is no fold of cloth."""
    size = (512 * factor, 512 * factor)
    crowd = landmarker.detect(cv2.resize(astronaut(), size, interpolation=cv2.INTER_CUBIC))
    for face in (crowd[0], max(crowd, key=lambda f: f.score)):
        off = np.linalg.norm(face.points / factor - found[0].points, axis=1)
        assert np.median(off) < 0.05 * found[0].eye_distance_px


def test_small_faces_are_found_at_a_second_look(landmarker, found):
    smaller = cv2.resize(astronaut(), (256, 256), interpolation=cv2.INTER_AREA)
    (face,) = landmarker.detect(smaller)
    off = np.linalg.norm(face.points * 2 - found[0].points, axis=1)
    assert np.median(off) < 0.1 * found[0].eye_distance_px


def test_several_faces_come_largest_first(landmarker, found):
    picture = np.zeros((512, 768, 3), np.uint8)
    picture[256:, :256] = cv2.resize(astronaut(), (256, 256), interpolation=cv2.INTER_AREA)
    picture[:, 256:] = astronaut()
    large, *others = landmarker.detect(picture)
    np.testing.assert_allclose(large.points - [256, 0], found[0].points, atol=4)
    if isinstance(landmarker, MediaPipeLandmarker):  # dlib stops where it has found one
        (small,) = others
        off = np.linalg.norm((small.points - [0, 256]) * 2 - found[0].points, axis=1)
        assert off.mean() < 0.05 * found[0].eye_distance_px


@pytest.mark.parametrize("shape", [(1, 1, 3), (40, 300, 3), (240, 320, 3)])
def test_no_face_in_nothing(landmarker, shape):
    assert landmarker.detect(np.zeros(shape, np.uint8)) == []
    noise = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    assert landmarker.detect(noise) == []


def test_it_is_a_landmarker_and_loads_once(landmarker):
    assert isinstance(landmarker, FaceLandmarker)
    name = "mediapipe" if isinstance(landmarker, MediaPipeLandmarker) else "dlib"
    assert choose_landmarker(name) is landmarker


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
    pytest.importorskip("dlib", reason="the extra dlib is not installed")
    assert predictor_path().is_file()


def test_a_missing_predictor_says_what_to_install(monkeypatch, tmp_path):
    class Empty:
        def locate_file(self, name):
            return tmp_path / name

    def nothing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    metadata = dlib_landmarks.importlib.metadata
    monkeypatch.setattr(metadata, "distribution", lambda name: Empty())
    with pytest.raises(AssetError, match="reinstall"):
        predictor_path()
    monkeypatch.setattr(metadata, "distribution", nothing)
    with pytest.raises(DependencyError, match=r"pip install 'skylight-lighting\[dlib\]'"):
        predictor_path()


def test_without_the_extra_mediapipe_works_and_dlib_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "dlib", None)  # Python's own way to refuse an import
    with pytest.raises(DependencyError, match=r"pip install 'skylight-lighting\[dlib\]'$"):
        DlibLandmarker()
    assert MediaPipeLandmarker().detect(astronaut())


def test_a_face_that_is_hard_to_see_is_found_and_scored_as_such():
    pytest.importorskip("dlib", reason="the extra dlib is not installed")
    dlib = choose_landmarker("dlib")
    (seen,) = dlib.detect(astronaut())
    turn = cv2.getRotationMatrix2D((225.0, 130.0), 48.0, 1.0)
    (face,) = dlib.detect(cv2.warpAffine(astronaut(), turn, (512, 512)))
    assert face.score < 0 < seen.score
    middle = turn[:, :2] @ seen.points.mean(0) + turn[:, 2]
    assert np.linalg.norm(face.points.mean(0) - middle) < 0.5 * seen.eye_distance_px
