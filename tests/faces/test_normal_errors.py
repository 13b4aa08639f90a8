"""Normal errors of fitted heads: derivatives against differences, modes against sampled heads."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.faces._fit import FIRST_OF_SHAPE, FaceFit, FitProblem, camera_project, fit_face
from skylight.faces._model import HeadModel, MeshPoints, Region, correspondence
from skylight.faces._normal_errors import (
    MODES,
    normal_changes,
    normal_error_modes,
    vertex_normal_derivatives,
)
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize, vertex_normals
from tests.faces.test_fit import HEIGHT, WIDTH, detected, person, state_of


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def fit(head) -> FaceFit:
    return fit_face(head, detected(head, person(head, 3), noise=0.004), WIDTH, HEIGHT)


def normals_of(head, vertices, corners=None):
    """Of all vertices, or right for those at ``corners`` alone."""
    faces = head.faces if corners is None else head.faces[np.isin(head.faces, corners).any(1)]
    return vertex_normals(torch.from_numpy(vertices), torch.from_numpy(faces)).numpy()


@pytest.fixture(scope="module")
def surface(head, fit):
    faces, vertices = torch.from_numpy(head.faces), torch.from_numpy(fit.vertices)
    return rasterize(fit.camera, vertices, faces, Raycaster(vertices, faces))


def normals_at(head, fit, step, surface, points):
    """Unit normals at points of the G-buffer, of the fit's head moved by a step."""
    problem = FitProblem(head, correspondence(head, detected(head, fit)), WIDTH, HEIGHT, None)
    corners = head.faces[surface.faces[points].numpy()]
    moved = state_of(fit).stepped(step, problem.identities)
    shape = head.vertices(moved.identity, moved.expression) @ moved.rotation.T
    weights = surface.barycentric[points].numpy()
    mixed = np.einsum("pc,pcd->pd", weights, normals_of(head, shape, corners)[corners])
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def test_derivatives_are_those_of_differences(head):
    shape = np.concatenate([head.identity_basis[..., :12], head.expression_basis[..., :4]], 2)
    normals, by_vertices = vertex_normal_derivatives(head.mean, head.faces)
    found = (by_vertices @ shape.reshape(-1, shape.shape[2])).reshape(shape.shape)
    np.testing.assert_allclose(normals, normals_of(head, head.mean), atol=1e-9)
    step = 1e-4
    right = np.stack(
        [
            (normals_of(head, head.mean + step * each) - normals_of(head, head.mean - step * each))
            / (2 * step)
            for each in np.moveaxis(shape, 2, 0)
        ],
        2,
    )
    skin = head.regions == Region.FACE
    off = np.linalg.norm((found - right)[skin]) / np.linalg.norm(right[skin])
    assert off < 0.07  # the weights' own derivatives are left out


def test_covariance_is_the_inverse_of_the_costs_curvature(head, fit):
    # points of the mesh, which do not slide; no error is left, so J^T J is the whole curvature
    mean, identity, expression = head.mesh_basis
    points = mean + identity @ fit.identity + expression @ fit.expression
    readings = np.zeros((1, 478, 2))
    readings[0, head.mesh_points] = camera_project(
        fit.camera, points @ fit.rotation.T + fit.translation
    )
    problem = FitProblem(head, MeshPoints(head, readings), WIDTH, HEIGHT, None)
    state, _, _ = problem.minimise(state_of(fit), iterations=60, pose_only=False)
    covariance = problem.covariance(state)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
    inverse = np.linalg.inv(covariance)
    chosen = [0, 1, 2, FIRST_OF_SHAPE, FIRST_OF_SHAPE + 5, FIRST_OF_SHAPE + 80]
    for k in chosen:
        step = np.zeros(len(covariance))
        step[k] = 0.05 * covariance[k, k] ** 0.5
        ahead, behind = (
            problem.cost(state.stepped(sign * step, problem.identities)) for sign in (1, -1)
        )
        # the cost is twice the negative log posterior
        bent = (ahead + behind - 2 * problem.cost(state)) / 2 / step[k] ** 2
        assert bent == pytest.approx(inverse[k, k], rel=0.05)


def test_modes_are_the_spread_of_sampled_heads(head, fit, surface):
    # small errors, so that normals are linear in them
    small = replace(fit, covariance=0.01 * fit.covariance)
    on_skin = (head.regions == Region.FACE)[head.faces[surface.faces.numpy()]].all(1)
    used = torch.from_numpy(on_skin & (np.arange(len(surface)) % 60 == 0))
    used &= (surface.normals * surface.positions).sum(1) < -0.25 * surface.positions.norm(dim=1)
    used = used.nonzero()[:, 0]
    errors = normal_error_modes(head, small, surface, used)
    modes = errors.modes
    assert modes.shape == (len(used), 3, MODES)
    rng, samples = np.random.default_rng(0), []
    root = np.linalg.cholesky(small.covariance)
    for _ in range(200):
        step = root @ rng.standard_normal(len(root))
        samples.append(normals_at(head, fit, step, surface, used))
    apart = np.stack(samples) - surface.normals[used].numpy()
    seen = np.einsum("spc,spd->pcd", apart, apart) / len(apart)
    told = np.einsum("pck,pdk->pcd", modes.double().numpy(), modes.double().numpy())
    # the modes keep most of it, and tell where and which way normals err
    assert 0.8 < np.trace(told.sum(0)) / np.trace(seen.sum(0)) < 1.02
    assert np.corrcoef(told.ravel(), seen.ravel())[0, 1] > 0.97
    # perpendicular to the normals
    along = np.einsum("pc,pck->pk", surface.normals[used].numpy(), modes.double().numpy())
    assert np.abs(along).max() < 1e-6


def test_an_error_of_the_head_turns_normals_at_any_points(head, fit, surface):
    """The modes of some points are errors of pose and shape, so they tell of all others."""
    some, others = torch.arange(0, len(surface), 40), torch.arange(7, len(surface), 20)
    errors = normal_error_modes(head, fit, surface, some)
    amounts = torch.linspace(-1.0, 1.0, MODES)
    error = errors.axes @ amounts
    torch.testing.assert_close(
        normal_changes(head, fit, surface, some, error),
        (errors.modes @ amounts).double(),
        rtol=1e-4,
        atol=1e-5,
    )
    found = normal_changes(head, fit, surface, others, error).numpy()
    # beside the normals of a head that is off by as little as derivatives hold for
    step = 1e-3
    root = np.linalg.cholesky(fit.covariance)
    along = step * root @ error.double().numpy()
    ends = [normals_at(head, fit, sign * along, surface, others) for sign in (1, -1)]
    right = (ends[0] - ends[1]) / (2 * step)
    assert np.linalg.norm(found - right) / np.linalg.norm(right) < 0.1


def test_a_known_head_has_none(head, surface):
    truth = person(head, 1)
    used = torch.arange(len(surface))
    assert normal_error_modes(head, truth, surface, used) is None
