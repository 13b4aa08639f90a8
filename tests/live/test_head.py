"""A head followed by landmarks whose pose is known."""

import numpy as np
import torch

from skylight.faces._model import HeadModel, Region
from skylight.live._head import POINTS, LiveHead, face_points
from skylight.transport._matrix import diffuse_transport
from tests.live.heads import CAMERA, angle_deg, detected, landmarks, mean_caster, mean_skin, turned

PLACE = np.array([0.02, 0.01, -0.9])


def test_points_are_spread_over_the_face() -> None:
    model, points = HeadModel.load(), face_points()
    assert len(set(points.tolist())) == POINTS
    assert (model.regions[points] == Region.FACE).all()
    places = model.mean[points]
    apart = np.linalg.norm(places[:, None] - places, axis=2) + np.eye(POINTS)
    assert apart.min() > 0.003
    # and no place of the face is far from one
    face = model.mean[model.regions == Region.FACE]
    assert np.linalg.norm(face[:, None] - places, axis=2).min(1).max() < 0.01


def test_transport_is_that_of_all_rays() -> None:
    """But for 1 % of the entries, which make up 1 % of no point's shading."""
    skin = mean_skin()
    some = slice(0, None, 20)
    normals = torch.from_numpy(skin.normals[some].copy())
    whole = diffuse_transport(
        torch.from_numpy(skin.positions[some].copy()), normals, normals, mean_caster(), skin.grid
    ).matrix.numpy()
    apart = np.abs(whole - skin.transport[some])
    assert (apart > 1e-6).mean() < 0.01  # narrow occluders and gaps that no cast ray met
    assert apart.sum(1).max() < 0.01


def test_the_pose_is_followed_through_turns_and_words() -> None:
    """5 degrees and 1 cm a frame, the mouth moving: to 1.5 degrees and 2.5 of 250 pixels."""
    model = HeadModel.load()
    still = np.zeros(model.expression_basis.shape[2])
    first = turned(-10.0, 5.0)
    seen = landmarks(model.average, still, first, PLACE)
    head = LiveHead(model, detected(seen), CAMERA.width, CAMERA.height)
    for step in range(1, 5):
        rotation = turned(-10.0 + 5 * step, 5.0 - 2 * step, 2.0 * step)
        place = PLACE + step * np.array([0.01, -0.004, 0.01])
        expression = still.copy()
        expression[3] = 0.15 * step
        assert head.follow(landmarks(model.average, expression, rotation, place))
        relative = head.state.rotation @ rotation.T
        angle = np.degrees(np.arccos(np.clip((np.trace(relative) - 1) / 2, -1, 1)))
        assert angle < 1.5
        _, seen_at = head.places()
        posed = model.vertices(model.average, expression)[head.skin.vertices]
        truth = CAMERA.project(torch.from_numpy(posed @ rotation.T + place)).numpy()
        assert np.sqrt(((seen_at - truth) ** 2).sum(1).mean()) < 2.5


def test_places_look_where_the_head_looks() -> None:
    model = HeadModel.load()
    still = np.zeros(model.expression_basis.shape[2])
    rotation = turned(20.0)
    seen = landmarks(model.average, still, rotation, PLACE)
    head = LiveHead(model, detected(seen), CAMERA.width, CAMERA.height)
    assert angle_deg(head.state.rotation[:, 2], rotation[:, 2]) < 1.5


def test_another_head_is_not_followed() -> None:
    """Landmarks that are no head's, or one upside down: the pose stays as it was."""
    model = HeadModel.load()
    still = np.zeros(model.expression_basis.shape[2])
    seen = landmarks(model.average, still, turned(0.0), PLACE)
    head = LiveHead(model, detected(seen), CAMERA.width, CAMERA.height)
    before = head.state
    scattered = seen + np.random.default_rng(3).normal(0, 60, seen.shape)
    mirrored = seen * [1, -1] + [0, 480]
    for other in (scattered, mirrored):
        assert not head.follow(other)
        assert head.state is before
    assert head.follow(seen)
