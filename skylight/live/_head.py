"""A head that moves: its shape found once, its pose in every frame, its transport in its own frame.

What reaches a point of the head from a direction of the *head's* frame does not change while it
turns, so rays are cast once a person: light is found in the head's frame, and turned.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from skylight.faces._fit import FitState, fit_face
from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import HeadModel, Region
from skylight.faces._next_pose import followed_pose
from skylight.sphere._frame import DirectionGrid
from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster
from skylight.transport._render import vertex_normals
from skylight.transport._visibility import adaptive_visibility

POINTS = 400  # of the face's skin: each stands for 0.6 cm^2
ROWS = 32  # of the directions from which light comes: cells of 5.6 degrees


@dataclass(frozen=True, kw_only=True)
class SkinPoints:
    """Points of a head's skin in its own frame, at rest.

    ``vertices`` (p,) of the head model; ``transport`` (p,n) of light from ``grid``.
    """

    vertices: Int[ndarray, " p"]
    positions: Float[ndarray, "p 3"]
    normals: Float[ndarray, "p 3"]
    transport: Float[ndarray, "p n"]
    grid: DirectionGrid

    @staticmethod
    def of(model: HeadModel, identity: Float[ndarray, " k"]) -> "SkinPoints":
        """:data:`POINTS` of the face of that person, whose expression is at rest."""
        resting = model.vertices(identity, np.zeros(model.expression_basis.shape[2]))
        vertices, faces = torch.from_numpy(resting), torch.from_numpy(model.faces.copy())
        chosen = face_points().copy()
        smooth = vertex_normals(vertices, faces)[torch.from_numpy(chosen)]
        seen = adaptive_visibility(
            vertices[torch.from_numpy(chosen)], smooth, smooth, Raycaster(vertices, faces), ROWS
        )
        return SkinPoints(
            vertices=chosen,
            positions=resting[chosen],
            normals=smooth.numpy(),
            transport=seen.transport().matrix.numpy(),
            grid=seen.grid,
        )


@cache
def face_points() -> Int[ndarray, " p"]:
    """Vertices of the mean head's face that lie apart: each the farthest from those before."""
    model = HeadModel.load()
    inside = np.flatnonzero(model.regions == Region.FACE)
    places = model.mean[inside]
    chosen = [int(np.argmax(places[:, 2]))]  # the nose's tip
    distance = np.full(len(inside), np.inf)
    for _ in range(POINTS - 1):
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    found = inside[chosen]
    found.flags.writeable = False  # shared by every caller
    return found


class LiveHead:
    """One person's head: shape and focal length from a first look, then a pose for each frame.

    ``skin`` is in the head's own frame. ``face`` is what the landmarker read, several times, in a
    picture of ``width`` x ``height``.
    """

    def __init__(self, model: HeadModel, face: DetectedFace, width: int, height: int) -> None:
        fit = fit_face(model, face, width, height)
        self.model = model
        self.size = width, height
        self.state = FitState(
            rotation=fit.rotation,
            translation=fit.translation,
            log_focal=float(np.log(fit.camera.focal_px)),
            identity=fit.identity,
            expression=fit.expression,
        )
        self.skin = SkinPoints.of(model, fit.identity)
        at = self.skin.vertices.copy()
        self._basis = model.mean[at] + model.identity_basis[at] @ fit.identity
        self._by_expression = model.expression_basis[at]

    @property
    def camera(self) -> Camera:
        width, height = self.size
        return Camera(
            focal_px=float(np.exp(self.state.log_focal)),
            width=width,
            height=height,
            center_px=(width / 2, height / 2),
        )

    def follow(self, points: Float[ndarray, "478 2"]) -> bool:
        """Pose and expression from the landmarks of the next frame, by Gauss-Newton steps.

        The shape and the focal length stay. False, and as before, where it is another head, or it
        moved further than :func:`~skylight.faces._next_pose.followed_pose` reaches.
        """
        state = followed_pose(self.model, self.state, points, self.size)
        if state is None:
            return False
        self.state = state
        return True

    def places(self) -> tuple[Float[ndarray, "p 3"], Float[ndarray, "p 2"]]:
        """The points of the skin in the camera's frame, with their expression, and in the picture.

        Pixels (x, y), pixel centres at +0.5.
        """
        posed = self._basis + self._by_expression @ self.state.expression
        placed = posed @ self.state.rotation.T + self.state.translation
        return placed, self.camera.project(torch.from_numpy(placed)).numpy()
