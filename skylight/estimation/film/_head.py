"""One head for all keyframes of a film: shape and focal length shared, poses their own.

Minimised over all frames' poses and expressions and one identity a and focal length f, ::

    sum_k [ e_k^T S_k^-1 e_k + |a - a_0|^2 + |b_k|^2 / s^2 + (log f - log f_0)^2 / sigma_f^2 ],

in the terms of :mod:`skylight.faces._fit`. The priors of what is shared count once for each frame,
since a landmarker's errors go together from frame to frame: many frames are no more certain than
one, but their mean.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.faces._fit import (
    FIRST_OF_SHAPE,
    FaceFit,
    FitProblem,
    FitState,
    fit_face,
    landmarks_of,
)
from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import HeadModel, correspondence

_ITERATIONS = 30
_TOLERANCE = 1e-6
_POSE = 6


def fit_head(
    model: HeadModel,
    faces: Sequence[DetectedFace],
    size: tuple[int, int],
    *,
    focal_px: float | None = None,
) -> list[FaceFit]:
    """The head of one person in pictures of one camera, ``size`` (width, height) px.

    Starts from each picture's own fit. Gauss-Newton steps, damped by Levenberg and Marquardt, on
    normal equations in which each frame's pose and expression are eliminated first.
    """
    alone = [fit_face(model, face, *size, focal_px=focal_px) for face in faces]
    problems = [FitProblem(model, correspondence(model, face), *size, focal_px) for face in faces]
    log_focal = float(np.median([np.log(fit.camera.focal_px) for fit in alone]))
    identity = np.mean([fit.identity for fit in alone], axis=0)
    states = [_with_focal(fit, identity, log_focal) for fit in alone]
    states, converged = _minimised(problems, states)
    return [
        _fit(model, problem, state, face, converged)
        for problem, state, face in zip(problems, states, faces, strict=True)
    ]


def _with_focal(fit: FaceFit, identity: Float[ndarray, " k"], log_focal: float) -> FitState:
    """Another focal length moves the head, so that it stays as large in the picture."""
    nearer = np.exp(log_focal) / fit.camera.focal_px
    return FitState(
        rotation=fit.rotation,
        translation=fit.translation * [1, 1, nearer],
        log_focal=log_focal,
        identity=identity,
        expression=fit.expression,
    )


def _minimised(
    problems: Sequence[FitProblem], states: list[FitState]
) -> tuple[list[FitState], bool]:
    identities = problems[0].identities
    cost, damping = _cost(problems, states), 1e-3
    for _ in range(_ITERATIONS):
        parts = [_normal_equations(p, s) for p, s in zip(problems, states, strict=True)]
        while True:
            steps = _steps(parts, identities, damping)
            trial = [s.stepped(step, identities) for s, step in zip(states, steps, strict=True)]
            trial_cost = _cost(problems, trial)
            if trial_cost < cost or damping > 1e6:
                break
            damping *= 8
        gain = cost - trial_cost
        if gain <= 0:
            return states, True
        states, cost, damping = trial, trial_cost, max(damping / 5, 1e-9)
        if gain < _TOLERANCE * (1 + cost):
            return states, True
    return states, False


def _cost(problems: Sequence[FitProblem], states: Sequence[FitState]) -> float:
    return sum(p.cost(s) for p, s in zip(problems, states, strict=True))


def _normal_equations(
    problem: FitProblem, state: FitState
) -> tuple[Float[ndarray, "p p"], Float[ndarray, " p"]]:
    gap, jacobian = problem.residuals(state)
    prior, slope = problem.prior(state)
    return jacobian.T @ jacobian + np.diag(slope**2), jacobian.T @ gap + slope * prior


def _steps(
    parts: Sequence[tuple[ndarray, ndarray]], identities: int, damping: float
) -> list[Float[ndarray, " p"]]:
    """Steps of all frames, whose focal length and identity step alike."""
    count = len(parts[0][1])
    shared = np.arange(_POSE, FIRST_OF_SHAPE + identities)
    own = np.setdiff1d(np.arange(count), shared)
    schur, right, eliminated = 0.0, 0.0, []
    for hessian, gradient in parts:
        damped = hessian + damping * np.diag(np.diag(hessian) + 1e-9)
        solved = np.linalg.solve(
            damped[np.ix_(own, own)],
            np.column_stack([damped[np.ix_(own, shared)], gradient[own]]),
        )
        across = damped[np.ix_(shared, own)]
        schur = schur + damped[np.ix_(shared, shared)] - across @ solved[:, :-1]
        right = right + gradient[shared] - across @ solved[:, -1]
        eliminated.append(solved)
    together = -np.linalg.solve(schur, right)
    steps = []
    for solved in eliminated:
        step = np.zeros(count)
        step[shared] = together
        step[own] = -solved[:, -1] - solved[:, :-1] @ together
        steps.append(step)
    return steps


def _fit(
    model: HeadModel,
    problem: FitProblem,
    state: FitState,
    face: DetectedFace,
    converged: bool,
) -> FaceFit:
    shape = model.vertices(state.identity, state.expression)
    fit = FaceFit(
        camera=problem.camera(state),
        rotation=state.rotation,
        translation=state.translation,
        identity=state.identity,
        expression=state.expression,
        vertices=shape @ state.rotation.T + state.translation,
        landmark_error=0.0,
        converged=converged,
        covariance=problem.covariance(state),
    )
    gap = face.points - landmarks_of(model, fit)
    error = float(np.linalg.norm(gap, axis=1).mean() / face.eye_distance_px)
    return replace(fit, landmark_error=error)
