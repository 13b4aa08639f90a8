"""Fitting the head to landmarks whose head, pose and camera are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skylight.faces._fit import (
    FaceFit,
    FitProblem,
    FitState,
    camera_project,
    fit_face,
    landmarks_of,
)
from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import HeadModel, correspondence
from skylight.transport._cameras import Camera

WIDTH, HEIGHT = 640, 480
PEOPLE = 10


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return HeadModel.load()


def person(head, seed) -> FaceFit:
    """A random person, pose and lens."""
    rng = np.random.default_rng(seed)
    identity, expression = head.sample(rng)
    angles = np.radians(rng.normal(size=3) * [15, 8, 5])
    rotation = Rotation.from_euler("yxz", angles).as_matrix()
    focal = WIDTH * rng.uniform(1.5, 2.5)
    translation = np.array([*rng.normal(0, 0.03, 2), -focal * 0.14 / (HEIGHT * 0.4)])
    return FaceFit(
        camera=Camera(
            focal_px=focal, width=WIDTH, height=HEIGHT, center_px=(WIDTH / 2, HEIGHT / 2)
        ),
        rotation=rotation,
        translation=translation,
        identity=identity,
        expression=expression,
        vertices=head.vertices(identity, expression) @ rotation.T + translation,
        landmark_error=0.0,
        converged=True,
    )


def detected(head, truth, noise=0.0, seed=0) -> DetectedFace:
    """Projected landmarks, off by ``noise`` eye distances."""
    exact = DetectedFace(points=landmarks_of(head, truth), score=1.0)
    offset = np.random.default_rng(seed).normal(size=(68, 2)) * noise * exact.eye_distance_px
    return replace(exact, points=exact.points + offset)


def state_of(fit) -> FitState:
    return FitState(
        rotation=fit.rotation,
        translation=fit.translation,
        log_focal=float(np.log(fit.camera.focal_px)),
        identity=fit.identity,
        expression=fit.expression,
    )


def degrees_apart(a, b):
    return np.degrees(Rotation.from_matrix(a.rotation @ b.rotation.T).magnitude())


@pytest.fixture(scope="module")
def fitted(head):
    """(truth, detection, fit) of some people with slightly wrong landmarks."""
    out = []
    for seed in range(PEOPLE):
        truth = person(head, seed)
        face = detected(head, truth, noise=0.005, seed=seed)
        out.append((truth, face, fit_face(head, face, WIDTH, HEIGHT)))
    return out


def test_poses_come_back(fitted):
    errors = [degrees_apart(fit, truth) for truth, _, fit in fitted]
    assert np.median(errors) < 2.5
    assert max(errors) < 8
    assert all(fit.converged for _, _, fit in fitted)


def test_no_better_head_is_known_than_the_one_found(head, fitted):
    # the true head explains the landmarks, but is less likely beforehand
    for truth, face, fit in fitted:
        problem = FitProblem(head, correspondence(head, face), WIDTH, HEIGHT, None)
        assert problem.cost(state_of(fit)) <= problem.cost(state_of(truth))


def test_fits_lie_as_close_as_the_landmarks_were_good(fitted):
    assert all(fit.landmark_error < 0.04 for _, _, fit in fitted)
    # distance and focal length trade off, but heads come out at their true size
    for truth, _, fit in fitted:
        focal = fit.camera.focal_px / truth.camera.focal_px
        depth = fit.translation[2] / truth.translation[2]
        assert depth / focal == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_inner_landmarks_are_met_where_asked_for(head, fitted, seed):
    _, face, plain = fitted[seed]
    fit = fit_face(head, face, WIDTH, HEIGHT, meet_landmarks=True)
    met = camera_project(fit.camera, head.landmarks(fit.vertices))
    assert np.linalg.norm(met - face.points, axis=1)[17:].max() < 0.5
    # only the skin moves, and only a little
    moved = np.linalg.norm(fit.vertices - plain.vertices, axis=1)
    assert 0 < moved.max() < 0.02
    assert (moved == 0).any()
    np.testing.assert_array_equal(plain.rotation, fit.rotation)
    assert plain.landmark_error == fit.landmark_error


def test_a_head_is_by_default_one_of_the_model(head, fitted):
    for _, _, fit in fitted:
        shape = head.vertices(fit.identity, fit.expression)
        np.testing.assert_allclose(
            fit.vertices, shape @ fit.rotation.T + fit.translation, atol=1e-12
        )


@pytest.mark.parametrize("seed", [3, 4])
def test_resolution_does_not_matter(head, fitted, seed):
    _, face, fit = fitted[seed]
    double = replace(face, points=2 * face.points)
    larger = fit_face(head, double, 2 * WIDTH, 2 * HEIGHT)
    assert degrees_apart(larger, fit) < 0.01
    np.testing.assert_allclose(larger.translation, fit.translation, atol=1e-4)
    assert larger.camera.focal_px == pytest.approx(2 * fit.camera.focal_px, rel=1e-4)
    assert larger.landmark_error == pytest.approx(fit.landmark_error, rel=1e-3)


def test_a_known_focal_length_is_kept(head):
    truth = person(head, 1)
    given = 3.2 * WIDTH  # far from the guess
    fit = fit_face(head, detected(head, truth), WIDTH, HEIGHT, focal_px=given)
    assert fit.camera.focal_px == pytest.approx(given, rel=0.15)


def test_moving_a_face_across_the_picture_moves_the_head(head, fitted):
    # the crop's centre is the optical axis: a face beside it is seen along a slanted ray
    _, face, fit = fitted[0]
    beside = replace(face, points=face.points + np.array([120.0, 0.0]))
    moved = fit_face(head, beside, WIDTH, HEIGHT)
    shift = moved.translation / -moved.translation[2] - fit.translation / -fit.translation[2]
    assert shift[0] * moved.camera.focal_px == pytest.approx(120, abs=12)


@pytest.mark.parametrize("yaw", [-0.7, 0.0, 0.4])
def test_the_facing_angle_is_that_of_the_turn(head, yaw):
    fit = replace(
        person(head, 0),
        rotation=Rotation.from_euler("y", yaw).as_matrix(),
        translation=np.array([0.0, 0.0, -1.0]),
    )
    assert fit.facing_angle_rad == pytest.approx(abs(yaw), abs=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_the_jacobian_is_that_of_finite_differences(head, seed):
    truth = person(head, seed)
    face = detected(head, truth, noise=0.05, seed=seed)
    problem = FitProblem(head, correspondence(head, face), WIDTH, HEIGHT, None)
    rng = np.random.default_rng(seed)
    state = problem.start(0.3)
    size = problem.identities + len(state.expression)
    state = state.stepped(rng.normal(size=7 + size) * 0.02, problem.identities)
    _, jacobian = problem.residuals(state)
    prior, slope = problem.prior(state)
    scale = np.abs(jacobian).max()
    eps = 1e-6
    for k in range(7 + size):
        step = np.zeros(7 + size)
        step[k] = eps
        ahead, behind = (state.stepped(s, problem.identities) for s in (step, -step))
        numeric = (problem.residuals(ahead)[0] - problem.residuals(behind)[0]) / (2 * eps)
        np.testing.assert_allclose(jacobian[:, k], numeric, atol=1e-6 * scale, rtol=1e-5)
        bent = (problem.prior(ahead)[0] - problem.prior(behind)[0]) / (2 * eps)
        np.testing.assert_allclose(bent, slope * (np.arange(7 + size) == k), atol=1e-6)
    gap, _ = problem.residuals(state)
    assert problem.cost(state) == pytest.approx((gap**2).sum() + (prior**2).sum())


def test_minimising_never_raises_the_cost(head):
    face = detected(head, person(head, 7), noise=0.02)
    problem = FitProblem(head, correspondence(head, face), WIDTH, HEIGHT, None)
    state = problem.start(0.0)
    costs = [problem.cost(state)]
    for _ in range(8):
        state, cost, _ = problem.minimise(state, iterations=2, pose_only=False)
        assert cost == pytest.approx(problem.cost(state))
        costs.append(cost)
    assert (np.diff(costs) <= 0).all()
    posed, _, _ = problem.minimise(problem.start(0.0), iterations=5, pose_only=True)
    assert (posed.identity == head.average).all()
    assert (posed.expression == 0).all()
    assert posed.log_focal == problem.log_focal0
