"""Fits of slots by other norms, and the simplest geometry of each slot."""

import numpy as np
import pytest
import torch
from scipy.optimize import linprog

from skylight.probes.voxel.faces import CONFIGURATIONS, ORIENTATIONS
from tools.measure_voxel_table import (
    least_power,
    lone_face,
    of_model,
    other_weights,
    with_noise,
    with_sum_of_one,
)

ROWS = torch.randn(4, 60, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
WANTED = torch.randn(60, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def test_least_magnitudes_are_those_of_the_linear_program() -> None:
    matrix, target = ROWS.T.numpy(), WANTED.numpy()
    count, eye = len(ROWS), np.eye(len(WANTED))
    program = linprog(
        np.r_[np.zeros(count), np.ones(len(target))],
        A_ub=np.block([[matrix, -eye], [-matrix, -eye]]),
        b_ub=np.r_[target, -target],
        bounds=[(None, None)] * count + [(0, None)] * len(target),
    )
    found = least_power(ROWS, WANTED, 1.0)
    missed = float((WANTED - ROWS.T @ found).abs().sum())
    assert missed == pytest.approx(program.fun, rel=1e-4)


def test_sums_of_one_leave_a_gradient_along_ones_alone() -> None:
    found = with_sum_of_one(ROWS, WANTED)
    assert float(found.sum()) == pytest.approx(1)
    gradient = ROWS @ (WANTED - ROWS.T @ found)
    torch.testing.assert_close(gradient, gradient.mean().expand(4))


def test_lone_faces_have_their_slot() -> None:
    for o in range(len(ORIENTATIONS)):
        for c in range(CONFIGURATIONS):
            faces, number = lone_face(o, c)
            assert (int(faces.orientation[number]), int(faces.configuration[number])) == (o, c)


def test_captured_slots_stay_and_weights_obey_their_constraint() -> None:
    made = other_weights(3, 0.8)
    for one in made.values():
        torch.testing.assert_close(
            one.weights[one.known], torch.eye(32).double().expand(6, -1, -1)[one.known]
        )
    assert made["non-negative"].weights.min() >= 0
    missing = made["sum of one"].weights[~made["sum of one"].known]
    torch.testing.assert_close(missing.sum(1), torch.ones(len(missing)).double())


def test_noise_of_transfer_makes_the_direct_weights_worse_sooner() -> None:
    """Their sum of squares is the larger one."""
    exact, noisy = with_noise(0.0), with_noise(0.002)
    growth = {name: noisy[name]["mean"] - exact[name]["mean"] for name in exact}
    assert growth["3-direct"] > 1.5 * growth["3-global"] > 0


def test_pictures_of_one_model_are_told_from_the_others() -> None:
    # two maps, three models, two views
    assert of_model([float(i) for i in range(12)], 1) == [2.0, 3.0, 8.0, 9.0]
