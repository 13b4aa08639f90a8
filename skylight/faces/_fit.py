"""Camera, pose and shape from landmarks: Levenberg-Marquardt on the morphable head.

Minimised over pose (R, t), focal length f, identity a and expression b::

    e^T S^-1 e + |a - a_0|^2 + |b|^2 / s^2 + (log f - log f_0)^2 / sigma_f^2

where e holds project(R X_i(a, b) + t; f) - x_i of all detected points, S is the second moment of
their errors (:mod:`skylight.faces._model`), and a_0 the average face.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from skylight._names import HeadName
from skylight.errors import InputError
from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import (
    JAW,
    Correspondence,
    HeadModel,
    PosedHead,
    correspondence,
    slid_landmarks,
)
from skylight.imaging._photo import Photo
from skylight.transport._cameras import Camera

EXPRESSION_SCALE = 0.7
# Where a picture does not tell: a portrait lens of 1.9 times the long side (68 mm on film),
# within a factor of about 1.35.
FOCAL_GUESS = 1.9
FOCAL_GUESS_SIGMA = 0.3
FOCAL_EXIF_SIGMA = 0.05
MOST_FACING_ANGLE_RAD = math.radians(60)  # beyond, most of what the light does is out of sight
FIRST_OF_SHAPE = 7  # of a step: after rotation, translation and focal length


@dataclass(frozen=True, kw_only=True)
class FaceFit:
    """A head in the camera's frame. ``vertices`` (n,3) in metres; the camera is at the origin.

    ``landmark_error`` is the mean distance of the landmarks to their detections, as a fraction
    of the distance of the outer eye corners, before the last smooth deformation.

    ``covariance`` is that of rotation (from the left), translation x and y in metres and z as its
    logarithm, log focal length, identity and expression, (J^T J + P)^-1 with the Jacobian J of the
    errors and the priors P; None where the head is known.
    """

    camera: Camera
    rotation: Float[ndarray, "3 3"]
    translation: Float[ndarray, "3"]
    identity: Float[ndarray, " k"]
    expression: Float[ndarray, " e"]
    vertices: Float[ndarray, "n 3"]
    landmark_error: float
    converged: bool
    covariance: Float[ndarray, "p p"] | None = None

    @property
    def facing_angle_rad(self) -> float:
        """Between the face's forward axis and the direction to the camera."""
        forward = self.rotation @ np.array([0.0, 0.0, 1.0])
        to_camera = -self.translation / np.linalg.norm(self.translation)
        return float(np.arccos(np.clip(forward @ to_camera, -1, 1)))


def fit_face(
    model: HeadModel,
    face: DetectedFace,
    width: int,
    height: int,
    *,
    focal_px: float | None = None,
    meet_landmarks: bool = False,
) -> FaceFit:
    """Fit the head to one detected face of a ``width`` x ``height`` picture.

    ``focal_px`` is the focal length from EXIF where known; otherwise it is guessed and refined.
    ``meet_landmarks`` spreads what remains between fit and detections over the skin, by bounded
    biharmonic weights, so that the inner landmarks are met in the picture, as the thesis does. It
    is off by default: with dlib's landmarks, off by several millimetres, it raised the median sun
    error of rendered faces from 6.4 to 8.3 degrees (11 faces), and with MediaPipe's it gains
    nothing (179 faces under one lamp: 6.3 and 6.4 degrees in the mean).
    """
    problem = FitProblem(model, correspondence(model, face), width, height, focal_px)
    # a turned head has local minima: start from three yaws and keep the best
    starts = [problem.start(yaw) for yaw in np.radians([-30.0, 0.0, 30.0])]
    posed = [problem.minimise(s, iterations=15, pose_only=True) for s in starts]
    best = min(posed, key=lambda result: result[1])[0]
    state, _, converged = problem.minimise(best, iterations=60, pose_only=False)
    camera = problem.camera(state)
    shape = model.vertices(state.identity, state.expression)
    marks = _placed_landmarks(model, state)
    gap = face.points - camera_project(camera, marks)
    error = float(np.linalg.norm(gap, axis=1).mean() / face.eye_distance_px)
    if meet_landmarks:
        # in the picture plane at each landmark's depth; sliding jaw points stay where they are
        depth = -marks[:, 2:]
        shift = np.concatenate([gap[:, :1], -gap[:, 1:], np.zeros_like(depth)], 1)
        shift = shift * depth / camera.focal_px
        shift[JAW] = 0
        shape = model.deform(shape, shift @ state.rotation)
    return FaceFit(
        camera=camera,
        rotation=state.rotation,
        translation=state.translation,
        identity=state.identity,
        expression=state.expression,
        vertices=shape @ state.rotation.T + state.translation,
        landmark_error=error,
        converged=converged,
        covariance=problem.covariance(state),
    )


def fit_visible(
    model: HeadModel, photo: Photo, face: DetectedFace, name: str, head: HeadName = "fitted"
) -> FaceFit:
    """The head of a face that is turned away by no more than 60 degrees.

    ``head`` is "fitted", the morphable model's, or "deformed": bent to meet the landmarks, see
    :func:`fit_face`.
    """
    if head not in ("fitted", "deformed"):
        raise InputError(f"{head!r} is no head; choose fitted or deformed")
    height, width = photo.encoded.shape[:2]
    fit = fit_face(
        model, face, width, height, focal_px=photo.focal_px, meet_landmarks=head == "deformed"
    )
    if fit.facing_angle_rad > MOST_FACING_ANGLE_RAD:
        raise InputError(
            f"{name}: the face is turned away by {math.degrees(fit.facing_angle_rad):.0f} "
            "degrees; use a picture that shows it from the front or at most half from the side"
        )
    return fit


def landmarks_of(model: HeadModel, fit: FaceFit) -> Float[ndarray, "68 2"]:
    """Where a head's landmarks lie in the picture, the jaw's on the silhouette."""
    return camera_project(fit.camera, _placed_landmarks(model, fit))


def _placed_landmarks(model: HeadModel, head: PosedHead) -> Float[ndarray, "68 3"]:
    """In the camera's frame."""
    points, _ = slid_landmarks(model, head)
    return points @ head.rotation.T + head.translation


def camera_project(camera: Camera, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 2"]:
    """Pixels (x, y) of points in front of the camera."""
    return camera.project(torch.from_numpy(np.ascontiguousarray(points))).numpy()


@dataclass(frozen=True, kw_only=True)
class FitState:
    """Pose, focal length (its logarithm, pixels) and shape of a head: what a fit changes."""

    rotation: Float[ndarray, "3 3"]
    translation: Float[ndarray, "3"]
    log_focal: float
    identity: Float[ndarray, " k"]
    expression: Float[ndarray, " e"]

    def stepped(self, step: Float[ndarray, " p"], identities: int) -> "FitState":
        """Rotation turned from the left by step[0:3]; the rest added."""
        return FitState(
            rotation=_turn(*step[:3]) @ self.rotation,
            # depth is stepped in proportion, so that it never changes sign
            translation=np.array(
                [
                    self.translation[0] + step[3],
                    self.translation[1] + step[4],
                    self.translation[2] * np.exp(np.clip(step[5], -1, 1)),
                ]
            ),
            log_focal=self.log_focal + step[6],
            identity=self.identity + step[FIRST_OF_SHAPE : FIRST_OF_SHAPE + identities],
            expression=self.expression + step[FIRST_OF_SHAPE + identities :],
        )


class FitProblem:
    """Residuals and Jacobian of the fit for one detection."""

    def __init__(
        self,
        model: HeadModel,
        seen: Correspondence,
        width: int,
        height: int,
        focal_px: float | None,
    ) -> None:
        self.seen = seen
        self.size = width, height
        self.average = model.average
        self.identities, self.expressions = (part.shape[2] for part in seen.basis[1:])
        known = focal_px is not None
        self.log_focal0 = np.log(focal_px if known else FOCAL_GUESS * max(width, height))
        self.focal_sigma = FOCAL_EXIF_SIGMA if known else FOCAL_GUESS_SIGMA

    def start(self, yaw: float) -> FitState:
        """The average face at the depth that the outer eye corners tell, rolled like them."""
        ahead = FitState(
            rotation=np.eye(3),
            translation=np.array([0.0, 0.0, -1.0]),
            log_focal=float(self.log_focal0),
            identity=self.average,
            expression=np.zeros(self.expressions),
        )
        points, _ = self.seen.points(ahead)
        first, second = self.seen.eyes
        right, left = self.seen.target[first], self.seen.target[second]
        roll = np.arctan2(-(left - right)[1], (left - right)[0])
        rotation = _turn(0.0, yaw, 0.0) @ _turn(0.0, 0.0, roll)
        focal = np.exp(self.log_focal0)
        apart = np.linalg.norm(points[second] - points[first]) * np.cos(yaw)
        depth = focal * apart / np.linalg.norm(left - right)
        middle = (left + right) / 2 - np.array(self.size) / 2
        centre = np.array([middle[0], -middle[1], -focal]) * depth / focal
        place = centre - rotation @ (points[first] + points[second]) / 2
        return replace(ahead, rotation=rotation, translation=place)

    def camera(self, state: FitState) -> Camera:
        width, height = self.size
        return Camera(
            focal_px=float(np.exp(state.log_focal)),
            width=width,
            height=height,
            center_px=(width / 2, height / 2),
        )

    def residuals(self, state: FitState) -> tuple[Float[ndarray, " q"], Float[ndarray, "q p"]]:
        """S^-1/2 e and its Jacobian by the step of :meth:`FitState.stepped`."""
        points, shape_jacobian = self.seen.points(state)
        rotated = points @ state.rotation.T
        placed = rotated + state.translation
        focal = np.exp(state.log_focal)
        depth = -placed[:, 2]
        x, y = placed[:, 0], placed[:, 1]
        gap = camera_project(self.camera(state), placed) - self.seen.target
        # d(u, v) / d(placed): u = f x / depth, v = -f y / depth
        count = len(points)
        projection = np.zeros((count, 2, 3))
        projection[:, 0, 0] = focal / depth
        projection[:, 0, 2] = focal * x / depth**2
        projection[:, 1, 1] = -focal / depth
        projection[:, 1, 2] = -focal * y / depth**2
        by_point = np.zeros((count, 3, FIRST_OF_SHAPE + shape_jacobian.shape[2]))
        # d(exp(w) q) / dw = -[q]x
        by_point[:, 0, 1], by_point[:, 0, 2] = rotated[:, 2], -rotated[:, 1]
        by_point[:, 1, 0], by_point[:, 1, 2] = -rotated[:, 2], rotated[:, 0]
        by_point[:, 2, 0], by_point[:, 2, 1] = rotated[:, 1], -rotated[:, 0]
        by_point[:, 0, 3] = by_point[:, 1, 4] = 1
        by_point[:, 2, 5] = state.translation[2]
        by_point[:, :, FIRST_OF_SHAPE:] = np.einsum("ij,ljp->lip", state.rotation, shape_jacobian)
        jacobian = np.einsum("luc,lcp->lup", projection, by_point)
        jacobian[:, 0, 6], jacobian[:, 1, 6] = focal * x / depth, -focal * y / depth
        whiten = self.seen.whiten
        return whiten @ gap.ravel(), whiten @ jacobian.reshape(2 * count, -1)

    def prior(self, state: FitState) -> tuple[Float[ndarray, " p"], Float[ndarray, " p"]]:
        """Residuals of the priors and their (diagonal) Jacobian; none on the pose."""
        value = np.concatenate(
            [
                np.zeros(6),
                [(state.log_focal - self.log_focal0) / self.focal_sigma],
                state.identity - self.average,
                state.expression / EXPRESSION_SCALE,
            ]
        )
        slope = np.concatenate(
            [
                np.zeros(6),
                [1 / self.focal_sigma],
                np.ones(len(state.identity)),
                np.full(len(state.expression), 1 / EXPRESSION_SCALE),
            ]
        )
        return value, slope

    def cost(self, state: FitState) -> float:
        """The objective at the top of this file."""
        points, _ = self.seen.points(state)
        placed = points @ state.rotation.T + state.translation
        gap = camera_project(self.camera(state), placed) - self.seen.target
        gap = self.seen.whiten @ gap.ravel()
        return float((gap**2).sum() + (self.prior(state)[0] ** 2).sum())

    def covariance(self, state: FitState) -> Float[ndarray, "p p"]:
        """Of :meth:`FitState.stepped`'s step, by Laplace's approximation at a minimum."""
        _, jacobian = self.residuals(state)
        _, slope = self.prior(state)
        return np.linalg.inv(jacobian.T @ jacobian + np.diag(slope**2))

    def minimise(
        self, state: FitState, *, iterations: int, pose_only: bool
    ) -> tuple[FitState, float, bool]:
        """(state, cost, converged); with ``pose_only`` shape and focal length stay.

        Converged: the last step gained less than 1e-6 relative, or no step gains anything.
        """
        count = FIRST_OF_SHAPE + self.identities + len(state.expression)
        free = 6 if pose_only else count
        damping, cost = 1e-2, self.cost(state)
        for _ in range(iterations):
            gap, jacobian = self.residuals(state)
            prior, slope = self.prior(state)
            hessian = jacobian.T @ jacobian + np.diag(slope**2)
            gradient = jacobian.T @ gap + slope * prior
            hessian, gradient = hessian[:free, :free], gradient[:free]
            while True:
                damped = hessian + damping * np.diag(np.diag(hessian) + 1e-9)
                step = np.zeros(count)
                step[:free] = -np.linalg.solve(damped, gradient)
                trial = state.stepped(step, self.identities)
                trial_cost = self.cost(trial)
                if trial_cost < cost or damping > 1e8:
                    break
                damping *= 8
            gain = cost - trial_cost
            if gain <= 0:
                return state, cost, True
            state, cost, damping = trial, trial_cost, max(damping / 5, 1e-9)
            if gain < 1e-6 * (1 + cost):
                return state, cost, True
        return state, cost, False


def _turn(x: float, y: float, z: float) -> Float[np.ndarray, "3 3"]:
    """The rotation of a rotation vector, radians."""
    return cv2.Rodrigues(np.array([x, y, z]))[0]  # scipy's takes 0.3 s to import
