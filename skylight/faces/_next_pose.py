"""The pose of a head whose shape is known, from one frame to the next."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.faces._fit import FIRST_OF_SHAPE, FitProblem, FitState, camera_project
from skylight.faces._landmarks import MESH_EYES
from skylight.faces._model import Basis, HeadModel, PosedHead, mesh_whitening

# Mean of the landmarks' errors over the distance of the eyes: rendered people have 0.02 to 0.05
MOST_ERROR = 0.15
POSE_STEPS = 2  # Gauss-Newton, from one frame to the next, which moves landmarks by pixels


class TrackedMesh:
    """MediaPipe's mesh as one glance has it, for :class:`~skylight.faces._fit.FitProblem`.

    Errors have the second moment of those on rendered people; those of one glance are somewhat
    larger than those of the mean of six, which counts for nothing where the shape is known.
    """

    def __init__(self, model: HeadModel, points: Float[ndarray, "478 2"]) -> None:
        right, left = MESH_EYES
        self.basis: Basis = model.mesh_basis
        self.target = points[model.mesh_points]
        rows = [int(np.flatnonzero(model.mesh_points == point)[0]) for point in MESH_EYES]
        self.eyes = rows[0], rows[1]
        self.whiten = mesh_whitening() / float(np.linalg.norm(points[left] - points[right]))

    def points(self, head: PosedHead) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 p"]]:
        mean, by_identity, by_expression = self.basis
        placed = mean + by_identity @ head.identity + by_expression @ head.expression
        return placed, np.concatenate(self.basis[1:], 2)


def followed_pose(
    model: HeadModel,
    state: FitState,
    points: Float[ndarray, "478 2"],
    size: tuple[int, int],
) -> FitState | None:
    """Pose and expression from the landmarks of the next frame, by Gauss-Newton steps.

    Shape and focal length stay. None where landmarks are not met to :data:`MOST_ERROR`: it is
    another head, or it moved further than steps reach. Pictures are of ``size`` (width, height).
    """
    seen = TrackedMesh(model, points)
    problem = FitProblem(model, seen, *size, None)
    shape = len(state.identity)
    free = np.r_[0:6, FIRST_OF_SHAPE + shape : FIRST_OF_SHAPE + shape + problem.expressions]
    for _ in range(POSE_STEPS):
        gap, jacobian = problem.residuals(state)
        prior, slope = problem.prior(state)
        moving = jacobian[:, free]
        hessian = moving.T @ moving + np.diag(slope[free] ** 2)
        step = np.zeros(jacobian.shape[1])
        step[free] = -np.linalg.solve(hessian, moving.T @ gap + (slope * prior)[free])
        state = state.stepped(step, shape)
    placed = seen.points(state)[0] @ state.rotation.T + state.translation
    gap = camera_project(problem.camera(state), placed) - seen.target
    right, left = seen.target[list(seen.eyes)]
    off = np.linalg.norm(gap, axis=1).mean() / np.linalg.norm(left - right)
    return state if (placed[:, 2] < 0).all() and off < MOST_ERROR else None
