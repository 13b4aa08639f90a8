"""The points of MediaPipe's mesh on the head, and what fits to them give."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skylight.faces._fit import FaceFit, camera_project, fit_face
from skylight.faces._landmarks import DetectedFace
from skylight.faces._mediapipe import IBUG, POINTS
from skylight.faces._model import HeadModel, MeshPoints, SlidingLandmarks, _mesh_moment
from skylight.transport._cameras import Camera

SIDE, FOCAL = 512, 900.0


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return HeadModel.load()


def person(head, seed) -> FaceFit:
    rng = np.random.default_rng(seed)
    identity, expression = head.sample(rng)
    rotation = Rotation.from_euler("yx", rng.normal(size=2) * [0.25, 0.12]).as_matrix()
    place = np.array([0, 0, -0.8])
    return FaceFit(
        camera=Camera(focal_px=FOCAL, width=SIDE, height=SIDE, center_px=(SIDE / 2, SIDE / 2)),
        rotation=rotation,
        translation=place,
        identity=identity,
        expression=expression,
        vertices=head.vertices(identity, expression) @ rotation.T + place,
        landmark_error=0.0,
        converged=True,
    )


def seen_mesh(head, truth):
    """(478,2) pixels: where a head's fitted points are, those that are not fitted at 0."""
    corners = truth.vertices[head.faces[head.mesh_faces]]
    points = np.zeros((POINTS, 2))
    on_head = np.einsum("qc,qcd->qd", head.mesh_bary, corners)
    points[head.mesh_points] = camera_project(truth.camera, on_head)
    return points


def read(points, *others):
    """A face with these readings; its 68 points are only for what does not fit them."""
    readings = np.stack([points, *others])
    return DetectedFace(points=readings.mean(0)[list(IBUG)], score=1.0, readings=readings)


def turn_deg(fit, truth):
    return np.degrees(Rotation.from_matrix(fit.rotation.T @ truth.rotation).magnitude())


def eye_distance(points):
    return np.linalg.norm(points[263] - points[33])


def test_the_average_face_is_symmetric_and_looks_ahead(head):
    face = head.vertices(head.average, np.zeros(head.expression_basis.shape[2]))
    marks = head.landmarks(face)
    right, left = marks[[36, 39, 48, 17, 2]], marks[[45, 42, 54, 26, 14]]
    np.testing.assert_allclose(left, right * [-1, 1, 1], atol=1e-3)
    # between the middle of MakeHuman's faces and this one lies as much as between people
    assert 2 < np.linalg.norm(head.average) < np.sqrt(len(head.average))


def test_the_mesh_lies_symmetrically_on_the_head(head):
    basis = head.mesh_basis()[0]
    rows = {int(point): i for i, point in enumerate(head.mesh_points)}
    right, left = basis[rows[33]], basis[rows[263]]  # outer corners of the eyes
    np.testing.assert_allclose(left, right * [-1, 1, 1], atol=2e-3)
    corner = head.landmarks(head.mean)[36]
    assert np.linalg.norm(right - corner) < 0.008
    chin, forehead = basis[rows[152]], basis[rows[10]]
    assert abs(chin[0]) < 2e-3
    assert abs(forehead[0]) < 2e-3
    assert forehead[1] - chin[1] > 0.15


def test_whitened_errors_are_white(head):
    points = seen_mesh(head, person(head, 0))
    seen = MeshPoints(head, points[None])
    moment = _mesh_moment() * eye_distance(points) ** 2
    white = seen.whiten @ moment @ seen.whiten.T
    np.testing.assert_allclose(white, np.eye(len(white)), atol=1e-8)


def test_poses_come_back_from_points_that_err_as_measured(head):
    errors, independent = [], []
    root = np.linalg.cholesky(_mesh_moment())
    for seed in range(6):
        truth = person(head, seed)
        points = seen_mesh(head, truth)
        rng = np.random.default_rng(seed)
        off = (root @ rng.normal(size=len(root))).reshape(-1, 2) * eye_distance(points)
        points[head.mesh_points] += off
        fit = fit_face(head, read(points), SIDE, SIDE, focal_px=FOCAL)
        errors.append(turn_deg(fit, truth))
        seen = MeshPoints(head, points[None])
        seen.whiten = np.diag(np.diag(_mesh_moment()) ** -0.5) / eye_distance(points)
        independent.append(turn_deg(_fit_with(head, seen), truth))
    assert np.mean(errors) < 3.5
    assert np.mean(errors) < 0.9 * np.mean(independent)


def _fit_with(head, seen):
    from skylight.faces._fit import FitProblem

    problem = FitProblem(head, seen, SIDE, SIDE, FOCAL)
    state, _, _ = problem.minimise(problem.start(0.0), iterations=60, pose_only=False)
    return state


def test_points_that_move_between_readings_lose_weight(head):
    truth = person(head, 1)
    points = seen_mesh(head, truth)
    jaw = [152, 148, 176, 150, 136, 172, 58, 132, 234, 454, 288, 378, 400]
    off = 0.25 * eye_distance(points)
    rng = np.random.default_rng(0)
    wrong = points.copy()
    wrong[jaw] += off  # as if a hand were the chin
    certain = fit_face(head, read(wrong, wrong, wrong, wrong), SIDE, SIDE, focal_px=FOCAL)
    moved = [wrong.copy() for _ in range(4)]
    for reading in moved:
        reading[jaw] += rng.normal(size=(len(jaw), 2)) * 2 * off
    unsure = fit_face(head, read(*moved), SIDE, SIDE, focal_px=FOCAL)
    assert turn_deg(unsure, truth) < 0.6 * turn_deg(certain, truth)


def test_jaw_landmarks_lie_on_the_silhouette(head):
    truth = person(head, 2)
    seen = SlidingLandmarks(head, np.zeros((68, 2)) + np.arange(68)[:, None])
    points, jacobian = seen.points(truth)
    rows = head.contour(head.vertices(truth.identity, truth.expression))
    for k in range(17):
        assert np.abs(rows[k] - points[k]).sum(1).min() < 1e-12
    step = 1e-3
    identity = truth.identity + step * np.eye(len(truth.identity))[3]
    more, _ = seen.points(replace(truth, identity=identity))
    np.testing.assert_allclose((more - points)[17:] / step, jacobian[17:, :, 3], atol=1e-9)
