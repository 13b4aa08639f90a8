"""A finer mesh through the model's vertices."""

import numpy as np
import trimesh

from skylight.faces._model import HeadModel
from skylight.people._skin import SmoothHead, rounded


def test_points_between_a_spheres_vertices_lie_on_the_sphere() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    edges = ball.edges_unique
    points = rounded(ball.vertices, ball.faces, edges)
    flat = np.linalg.norm(ball.vertices[edges].mean(1), axis=1)
    error = np.abs(np.linalg.norm(points[len(ball.vertices) :], axis=1) - 2.0)
    assert (2.0 - flat).min() > 0.004  # the middles of the chords lie within
    assert error.max() < 0.0005


def test_the_fine_head_keeps_the_models_vertices_area_and_sides() -> None:
    model, head = HeadModel.load(), SmoothHead.load()
    assert len(head.faces) == 4 * len(model.faces)
    np.testing.assert_array_equal(head.neutral[: len(model.mean)], model.mean)
    np.testing.assert_allclose(head.belongs.sum(0), 1)
    coarse = trimesh.Trimesh(model.mean, model.faces, process=False)
    fine = trimesh.Trimesh(head.neutral, head.faces, process=False)
    np.testing.assert_allclose(fine.area, coarse.area, rtol=0.01)
    # each of the four looks where the triangle that it was cut from does
    alike = (fine.face_normals.reshape(-1, 4, 3) * coarse.face_normals[:, None]).sum(-1)
    assert np.quantile(alike, 0.001) > 0.5
