"""A head that is posed as is known, the mean person's, and colours of it in a known light."""

from functools import cache

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import HeadModel
from skylight.live._head import SkinPoints
from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster

CAMERA = Camera(focal_px=900.0, width=640, height=480, center_px=(320.0, 240.0))
ALBEDO = np.array([0.42, 0.27, 0.20])


@cache
def mean_skin() -> SkinPoints:
    model = HeadModel.load()
    return SkinPoints.of(model, model.average)


@cache
def mean_caster() -> Raycaster:
    model = HeadModel.load()
    vertices = model.vertices(model.average, np.zeros(model.expression_basis.shape[2]))
    return Raycaster(torch.from_numpy(vertices), torch.from_numpy(model.faces.copy()))


def turned(yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> np.ndarray:
    """camera_from_head."""
    angles = [yaw_deg, pitch_deg, roll_deg]
    return Rotation.from_euler("YXZ", angles, degrees=True).as_matrix()


def lit(towards_in_head: np.ndarray, main: np.ndarray, ambient: np.ndarray) -> np.ndarray:
    """Colours (p,3) under a point light of irradiance ``main`` and constant ``ambient`` radiance.

    The light's rays are cast here, one by one; the ambient light reaches a point by how much it
    sees, which is the transport of a constant.
    """
    skin = mean_skin()
    cosine = (skin.normals @ towards_in_head).clip(0)
    origins = torch.from_numpy(skin.positions + 1e-3 * skin.normals)
    way = torch.from_numpy(np.tile(towards_in_head, (len(origins), 1)))
    cosine[mean_caster().occluded(origins, way).numpy()] = 0
    open_share = skin.transport.sum(1)
    return ALBEDO * (cosine[:, None] / np.pi * main + open_share[:, None] * ambient)


def facing_weights(camera_from_head: np.ndarray) -> np.ndarray:
    """Of a camera far away."""
    facing = mean_skin().normals @ camera_from_head[2]
    return np.where(facing > 0.25, facing, 0.0)


def angle_deg(one: np.ndarray, other: np.ndarray) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def landmarks(
    identity: np.ndarray,
    expression: np.ndarray,
    rotation: np.ndarray,
    translation: np.ndarray,
) -> np.ndarray:
    """(478,2): where :data:`CAMERA` sees the mesh's points; those that are not fitted are at 0."""
    mean, by_identity, by_expression = HeadModel.load().mesh_basis
    placed = mean + by_identity @ identity + by_expression @ expression
    seen = CAMERA.project(torch.from_numpy(placed @ rotation.T + translation)).numpy()
    points = np.zeros((478, 2))
    points[HeadModel.load().mesh_points] = seen
    return points


def detected(points: np.ndarray) -> DetectedFace:
    """As if read twice alike: every reading errs by less than a tenth of a pixel."""
    noise = np.random.default_rng(0).normal(0, 0.05, (6, *points.shape))
    corners = np.zeros((68, 2))
    corners[36], corners[45] = points[33], points[263]  # the eyes, against which errors count
    return DetectedFace(points=corners, score=1.0, readings=points + noise)
