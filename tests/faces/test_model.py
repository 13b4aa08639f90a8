"""The shipped head: anatomy, landmarks, bases, deformation."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from skylight.faces._fit import FaceFit, camera_project, fit_face
from skylight.faces._landmarks import DetectedFace
from skylight.faces._mediapipe import IBUG, POINTS
from skylight.faces._model import HeadModel, MeshPoints, Region, SlidingLandmarks, _mesh_moment
from skylight.transport._cameras import Camera

# Landmark i's mirror image in the iBUG scheme.
MIRROR = np.array(
    [
        *range(16, -1, -1),
        *range(26, 16, -1),
        *(27, 28, 29, 30, 35, 34, 33, 32, 31),
        *(45, 44, 43, 42, 47, 46, 39, 38, 37, 36, 41, 40),
        *(54, 53, 52, 51, 50, 49, 48, 59, 58, 57, 56, 55, 64, 63, 62, 61, 60, 67, 66, 65),
    ]
)


def contour(head, vertices):
    """The jaw landmarks' sliding candidates (17,c,3) on a head with these vertices."""
    corners = vertices[head.faces[head.contour_faces]]
    return np.einsum("lkc,lkcd->lkd", head.contour_bary, corners)


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def mean_landmarks(head):
    return head.landmarks(head.mean)


def triangle_normals(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def people(head, count, seed=0):
    generator = np.random.default_rng(seed)
    return [head.vertices(*head.sample(generator)) for _ in range(count)]


def test_file_is_small_and_loaded_once(head):
    assert len((files("skylight.faces") / "data" / "head.npz").read_bytes()) < 5_000_000
    assert HeadModel.load() is head


def test_shared_arrays_cannot_be_changed(head):
    with pytest.raises(ValueError, match="read-only"):
        head.mean[0] = 0


def test_faces_look_outwards(head, mean_landmarks):
    normals = triangle_normals(head.mean, head.faces)
    at_nose_tip = (head.faces == np.abs(head.mean - mean_landmarks[30]).sum(1).argmin()).any(1)
    tip = normals[at_nose_tip].sum(0)
    assert tip[2] / np.linalg.norm(tip) > 0.8
    # Eyeballs are closed: divergence theorem gives their volume, positive when oriented outwards.
    eyeball = head.faces[(head.regions[head.faces] == Region.EYEBALL).all(1)]
    volume = (
        np.einsum("fd,fd->", head.mean[eyeball[:, 0]], triangle_normals(head.mean, eyeball)) / 6
    )
    assert 2 * 5e-6 < volume < 2 * 25e-6  # two, of 5 to 25 millilitres


def test_axes(mean_landmarks):
    assert mean_landmarks[45, 0] > 0 > mean_landmarks[36, 0]  # +X is the person's left
    assert mean_landmarks[27, 1] > mean_landmarks[8, 1]  # +Y up
    assert mean_landmarks[30, 2] > mean_landmarks[[0, 16], 2].max() + 0.05  # +Z forward


def test_size_is_an_adults(head, mean_landmarks):
    assert 0.08 < np.linalg.norm(mean_landmarks[45] - mean_landmarks[36]) < 0.11
    skull = head.mean[np.isin(head.regions, [Region.FACE, Region.SCALP])]
    assert 0.13 < np.ptp(skull[:, 0]) < 0.17
    assert 0.10 < mean_landmarks[27, 1] - mean_landmarks[8, 1] < 0.13
    eyes = head.mean[head.regions == Region.EYEBALL]
    assert abs(eyes[:, 1].mean()) < 0.002  # the origin is at eye height
    assert abs(head.mean[:, 2].mean()) < 0.03


def test_landmarks_lie_on_skin(head):
    bary = head.landmark_bary
    assert (bary >= 0).all()
    assert np.allclose(bary.sum(1), 1)
    corner = head.regions[head.faces[head.landmark_faces]]
    assert not np.isin(corner[bary > 0.5], [Region.EYEBALL, Region.EAR]).any()
    assert (head.contour_bary >= 0).all()
    assert np.allclose(head.contour_bary.sum(-1), 1)


def test_mean_landmarks_are_symmetric(mean_landmarks):
    assert np.abs(mean_landmarks[MIRROR] * [-1, 1, 1] - mean_landmarks).max() < 1e-3


def test_lips_part_between_inner_landmarks(head):
    opening = head.expression_basis[..., head.expression_names.index("mouth-open")]
    inner = head.landmarks(opening)
    assert (np.abs(inner[61:64, 1]) < 1e-3).all()  # upper lip stays
    assert (inner[65:68, 1] < -5e-3).all()  # lower lip drops


def test_landmark_and_contour_bases_agree_with_the_mesh(head):
    identity, expression = head.sample(np.random.default_rng(3))
    vertices = head.vertices(identity, expression)
    mean, by_identity, by_expression = head.landmark_basis
    from_basis = mean + by_identity @ identity + by_expression @ expression
    assert np.allclose(from_basis, head.landmarks(vertices), atol=1e-9)
    mean, by_identity, by_expression = head.contour_basis
    from_basis = mean + by_identity @ identity + by_expression @ expression
    assert np.allclose(from_basis, contour(head, vertices), atol=1e-9)


def test_contour_rows_hold_their_landmark_and_run_backwards(head, mean_landmarks):
    rows = contour(head, head.mean)
    gap = np.linalg.norm(rows - mean_landmarks[:17, None], axis=2)
    assert (gap.min(1) < 1e-4).all()
    assert (rows[:, 0, 2] > rows[:, -1, 2] + 0.01).all()
    steps = np.linalg.norm(np.diff(rows, axis=1), axis=2)
    assert steps.max() < 0.012


def test_weights_are_bounded_and_leave_the_rest_still(head):
    weights = head.weights.toarray()
    assert (weights >= 0).all()
    assert (weights.sum(1) <= 1 + 1e-6).all()
    still = np.isin(head.regions, [Region.SCALP]) & (head.mean[:, 2] < -0.08)
    assert still.sum() > 50
    assert (weights[still] == 0).all()
    # Amid the face nothing is held back: a common displacement moves it as a whole.
    mid = (head.regions == Region.FACE) & (np.abs(head.mean[:, 0]) < 0.03) & (head.mean[:, 1] < 0)
    assert weights[mid].sum(1).min() > 0.9


def test_deform_moves_landmarks_exactly(head):
    generator = np.random.default_rng(1)
    vertices = head.vertices(*head.sample(generator))
    displacement = generator.normal(0, 3e-3, (68, 3))
    moved = head.landmarks(head.deform(vertices, displacement)) - head.landmarks(vertices)
    assert np.allclose(moved, displacement, atol=1e-6)


def test_samples_are_plausible(head):
    reference = triangle_normals(head.mean, head.faces)
    shown = (head.regions[head.faces] == Region.FACE).all(1)
    widths = []
    for vertices in people(head, 50):
        landmarks = head.landmarks(vertices)
        ears = vertices[head.regions == Region.EAR]
        assert landmarks[30, 2] > ears[:, 2].max()
        assert landmarks[30, 2] > landmarks[27, 2]
        turned = (triangle_normals(vertices, head.faces) * reference).sum(1) <= 0
        assert turned[shown].mean() < 0.01
        widths.append(np.linalg.norm(landmarks[45] - landmarks[36]))
    assert 0.002 < np.std(widths) < 0.008
    assert min(widths) > 0.075
    assert max(widths) < 0.11


def test_identity_components_are_symmetric_or_antisymmetric(head):
    _, basis, _ = head.landmark_basis
    mirrored = basis[MIRROR] * np.array([-1, 1, 1])[None, :, None]
    error = np.minimum(np.abs(mirrored - basis).max((0, 1)), np.abs(mirrored + basis).max((0, 1)))
    assert error.max() < 2e-5  # storage steps


def test_samples_repeat_with_their_generator(head):
    for make in (np.random.default_rng, lambda seed: torch.Generator().manual_seed(seed)):
        first, again, other = (head.sample(make(seed)) for seed in (5, 5, 6))
        assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
        assert not np.array_equal(first[0], other[0])


def test_regions(head):
    counts = np.bincount(head.regions, minlength=len(Region))
    assert (counts > 50).all()
    face = head.mean[head.regions == Region.FACE]
    assert face[:, 1].max() < 0.07
    assert head.mean[head.regions == Region.NECK, 1].max() < -0.06


SIDE, FOCAL = 512, 900.0


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
    basis = head.mesh_basis[0]
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
    rows = contour(head, head.vertices(truth.identity, truth.expression))
    for k in range(17):
        assert np.abs(rows[k] - points[k]).sum(1).min() < 1e-12
    step = 1e-3
    identity = truth.identity + step * np.eye(len(truth.identity))[3]
    more, _ = seen.points(replace(truth, identity=identity))
    np.testing.assert_allclose((more - points)[17:] / step, jacobian[17:, :, 3], atol=1e-9)
