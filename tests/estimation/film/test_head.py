"""One head fitted to several pictures of a person whose shape and poses are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skylight.estimation.film._head import fit_head
from skylight.faces._fit import FaceFit, FitProblem, FitState, fit_face, landmarks_of
from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import HeadModel, correspondence
from skylight.transport._cameras import Camera

SIZE, FOCAL = (640, 480), 1200.0
YAWS = (-30.0, -12.0, 5.0, 25.0)


def pose_of(head: HeadModel, yaw: float, seed: int = 0) -> FaceFit:
    """The same person, turned, with another expression for each yaw."""
    identity, _ = head.sample(np.random.default_rng(seed))
    _, expression = head.sample(np.random.default_rng(round(100 + yaw)))
    rotation = Rotation.from_euler("yx", [yaw, 4.0], degrees=True).as_matrix()
    translation = np.array([0.002 * yaw, 0.01, -0.9])
    return FaceFit(
        camera=Camera(
            focal_px=FOCAL, width=SIZE[0], height=SIZE[1], center_px=(SIZE[0] / 2, SIZE[1] / 2)
        ),
        rotation=rotation,
        translation=translation,
        identity=identity,
        expression=0.4 * expression,
        vertices=head.vertices(identity, 0.4 * expression) @ rotation.T + translation,
        landmark_error=0.0,
        converged=True,
    )


def detected(head: HeadModel, truth: FaceFit, seed: int) -> DetectedFace:
    """With errors of 2 % of the eyes' distance."""
    exact = DetectedFace(points=landmarks_of(head, truth), score=1.0)
    noise = np.random.default_rng(seed).normal(size=(68, 2)) * 0.02 * exact.eye_distance_px
    return replace(exact, points=exact.points + noise)


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def faces(head: HeadModel) -> list[DetectedFace]:
    return [detected(head, pose_of(head, yaw), k) for k, yaw in enumerate(YAWS)]


@pytest.fixture(scope="module")
def fits(head: HeadModel, faces: list[DetectedFace]) -> list[FaceFit]:
    return fit_head(head, faces, SIZE)


def test_shape_and_focal_length_are_shared(fits: list[FaceFit]) -> None:
    assert all(fit.converged for fit in fits)
    for fit in fits[1:]:
        np.testing.assert_array_equal(fit.identity, fits[0].identity)
        assert fit.camera.focal_px == fits[0].camera.focal_px


def test_poses_are_those_of_the_person(head: HeadModel, fits: list[FaceFit]) -> None:
    for fit, yaw in zip(fits, YAWS, strict=True):
        turned = Rotation.from_matrix(fit.rotation.T @ pose_of(head, yaw).rotation).magnitude()
        assert np.degrees(turned) < 6


def test_the_sum_of_all_costs_is_least(
    head: HeadModel, faces: list[DetectedFace], fits: list[FaceFit]
) -> None:
    """Finite differences of the sum along shared and own unknowns."""
    problems = [FitProblem(head, correspondence(head, face), *SIZE, None) for face in faces]
    states = [
        FitState(
            rotation=fit.rotation,
            translation=fit.translation,
            log_focal=float(np.log(fit.camera.focal_px)),
            identity=fit.identity,
            expression=fit.expression,
        )
        for fit in fits
    ]
    identities = problems[0].identities
    count = 7 + identities + len(fits[0].expression)

    def cost(step: np.ndarray, which: list[int]) -> float:
        return sum(
            p.cost(s.stepped(step if k in which else 0 * step, identities))
            for k, (p, s) in enumerate(zip(problems, states, strict=True))
        )

    everyone = list(range(len(fits)))
    rest = cost(np.zeros(count), [])
    for index, which in ((6, everyone), (8, everyone), (20, everyone), (1, [2]), (5, [0])):
        for sign in (-1, 1):
            step = np.zeros(count)
            step[index] = sign * 1e-2
            assert cost(step, which) > rest - 1e-4 * rest


def test_one_picture_is_the_fit_of_a_photograph(head: HeadModel, faces: list[DetectedFace]) -> None:
    (together,) = fit_head(head, faces[2:3], SIZE)
    alone = fit_face(head, faces[2], *SIZE)
    assert np.abs(together.vertices - alone.vertices).max() < 2e-3
    assert together.landmark_error == pytest.approx(alone.landmark_error, rel=0.05)


def test_many_pictures_tell_the_shape_better_than_one(
    head: HeadModel, faces: list[DetectedFace], fits: list[FaceFit]
) -> None:
    truth = pose_of(head, 0.0).identity
    alone = [fit_face(head, face, *SIZE).identity for face in faces]

    def off(identity: np.ndarray) -> float:
        shape = head.identity_basis @ (identity - truth)
        return float(np.sqrt((shape**2).sum(1).mean()))

    assert off(fits[0].identity) < np.median([off(one) for one in alone])
