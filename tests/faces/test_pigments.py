"""Smooth modes of pigments over the head: a kernel's spectrum, and colours of computed skin."""

import numpy as np
import pytest
from scipy.sparse.linalg import eigsh
from scipy.spatial import KDTree

from skylight.faces._model import HeadModel, Region
from skylight.faces._skin import MODES, PIGMENT_COLOURS, pigment_modes
from skylight.people._skin import skin_albedo

CORRELATION_M, SYMMETRY = 0.035, 0.8


@pytest.fixture(scope="module")
def face():
    """(vertices of the face, their shares of its area, the kernel between all of them).

    The kernel of the process less its mean, by the definition, with a node at each vertex.
    """
    model = HeadModel.load()
    on_face = model.regions == Region.FACE
    corners = model.faces[on_face[model.faces].all(1)]
    a, b, c = (model.mean[corners[:, i]] for i in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    area = np.zeros(len(model.mean))
    for i in range(3):
        np.add.at(area, corners[:, i], third)
    points, share = model.mean[on_face], area[on_face] / area[on_face].sum()

    def near(others):
        squared = sum((points[:, None, i] - others[None, :, i]) ** 2 for i in range(3))
        return np.exp(-squared / (2 * CORRELATION_M**2))

    kernel = near(points) + SYMMETRY * near(points * [-1, 1, 1])
    deviation = np.sqrt(np.diag(kernel))
    kernel /= deviation[:, None] * deviation
    centring = np.eye(len(points)) - share  # a field less its mean
    return points, share, centring @ kernel @ centring.T


@pytest.fixture(scope="module")
def modes():
    return pigment_modes()[HeadModel.load().regions == Region.FACE]


def test_modes_are_the_kernel_s_eigenfunctions(face, modes):
    _, share, kernel = face
    root = np.sqrt(share)
    values = eigsh(root[:, None] * kernel * root, k=MODES, return_eigenvectors=False)[::-1]
    overlaps = (modes * share[:, None]).T @ modes
    np.testing.assert_allclose(np.diag(overlaps), values, rtol=0.02)
    lengths = np.sqrt(np.diag(overlaps))
    cosines = overlaps / (lengths[:, None] * lengths)
    np.testing.assert_allclose(cosines, np.eye(MODES), atol=0.02)
    # and kernel f = lambda f
    np.testing.assert_allclose(kernel @ (share[:, None] * modes), modes * values, atol=4e-3)


def test_ten_modes_have_seven_eighths_of_the_variance(face, modes):
    _, share, kernel = face
    variance, kept = np.diag(kernel), (modes**2).sum(1)
    assert 0.86 < float(share @ kept) / float(share @ variance) < 0.89
    assert (kept < variance + 0.01).all()
    # covariances at distances of the correlation length and more come back
    assert np.sqrt(np.mean((modes @ modes.T - kernel) ** 2)) < 0.03


def test_modes_leave_the_mean_of_the_face_to_its_albedo(face, modes):
    _, share, _ = face
    assert np.abs(share @ modes).max() < 5e-3


def test_modes_are_even_or_odd_and_even_ones_come_first(face, modes):
    points, _, _ = face
    _, across = KDTree(points).query(points * [-1, 1, 1])
    parity = (modes[across] * modes).sum(0) / (modes**2).sum(0)
    np.testing.assert_allclose(np.abs(parity), 1, atol=1e-3)
    assert (parity[:5] > 0).all()
    assert (parity < 0).any()


def test_other_things_than_skin_do_not_vary():
    model = HeadModel.load()
    for region in (Region.EYEBALL, Region.MOUTH):
        assert (pigment_modes()[model.regions == region] == 0).all()


def test_colours_are_those_of_computed_skin():
    """Slopes of log albedo over the logs of the two amounts, with green at 1."""
    amounts, step = np.log([0.05, 0.017]), 0.1
    for axis, colour in enumerate(PIGMENT_COLOURS):
        either = np.array([amounts, amounts])
        either[:, axis] += [-step, step]
        less, more = np.log(skin_albedo(*np.exp(either).T))
        np.testing.assert_allclose((more - less) / (more - less)[1], colour, atol=0.02)
