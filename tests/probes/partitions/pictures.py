"""Pictures of partition probes whose faces shine as they are told, ray by ray."""

from collections.abc import Callable
from itertools import product

import numpy as np
import torch

from skylight.probes.cameras._board import Board
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics
from skylight.probes.cameras._pose import OPENCV_FROM_BOARD, camera_centre
from skylight.probes.partitions.printed._assembly import PlacedPartitions
from skylight.sphere._rotation import RigidTransform
from skylight.transport._rays import Raycaster
from tests.probes.cameras.scenes import picture_of_board, rays_through, shrink

Shine = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(cells (m,), points (m,3)) -> radiance (m,3)."""
WALLS = 0.01
KERNEL_MM, RADIUS_MM, FREE_MM = 9.0, 30.0, 8.0


def cube_probe(rotation: np.ndarray, middle: np.ndarray) -> PlacedPartitions:
    """A probe of six cells made by hand: a cube with a sheet from each edge outwards.

    Faces are +x, -x, +y, -y, +z, -z as the design "6d" has them.
    """
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    vertices = np.concatenate([KERNEL_MM * corners, RADIUS_MM / np.sqrt(3) * corners])
    triangles = []
    for axis, side in product(range(3), (-1, 1)):
        a, b, c, d = np.flatnonzero(corners[:, axis] == side).tolist()
        triangles += [[a, b, c], [b, c, d]]
    for i, j in product(range(8), repeat=2):
        if i < j and np.abs(corners[i] - corners[j]).sum() == 2:
            triangles += [[i, j, i + 8], [j, i + 8, j + 8]]
    normals = np.stack([s * np.eye(3)[axis] for axis in range(3) for s in (1, -1)]) @ rotation.T
    return PlacedPartitions(
        face_centres=KERNEL_MM * normals + middle,
        normals=normals,
        face_radii=np.full(6, FREE_MM),
        vertices=vertices @ rotation.T + middle,
        triangles=np.array(triangles),
    )


def picture_of_faces(
    probe: PlacedPartitions,
    shine: Shine,
    lens: Intrinsics,
    pose: RigidTransform,
    behind: np.ndarray | None = None,
) -> np.ndarray:
    """Linear light (h,w,3): shining faces, dark walls, and what is behind, as linear light too."""
    rays = rays_through(lens) @ FLIP @ pose.rotation.numpy()
    eye = camera_centre(pose)
    start = torch.from_numpy(eye).expand(len(rays), 3)
    hits = Raycaster(torch.from_numpy(probe.vertices), torch.from_numpy(probe.triangles)).intersect(
        start, torch.from_numpy(rays)
    )
    there = hits.face.numpy() >= 0
    points = eye + hits.distance.numpy()[there, None] * rays[there]
    above = np.einsum("mnc,nc->mn", points[:, None] - probe.face_centres, probe.normals)
    # a point outside of the kernel is above one of its faces
    on_face, cells = np.abs(above.max(1)) < 1e-3, above.argmax(1)
    seen = np.full((len(points), 3), WALLS)
    seen[on_face] = shine(cells[on_face], points[on_face])
    light, share = np.zeros((len(rays), 3)), np.zeros(len(rays))
    light[there], share[there] = seen, 1.0
    shape = 2 * lens.height, 2 * lens.width
    shining = np.stack([shrink(light[:, c].reshape(shape)) for c in range(3)], -1)
    empty = 1 - shrink(share.reshape(shape))[..., None]
    return shining + empty * (0.1 if behind is None else behind)


def board_seen(board: Board, lens: Intrinsics, pose: RigidTransform) -> np.ndarray:
    """Codes of the board alone, by ``camera_from_board``."""
    rotation = FLIP @ pose.rotation.numpy() @ OPENCV_FROM_BOARD.T
    return picture_of_board(board, lens, rotation, FLIP @ pose.translation.numpy())


def looking_from(towards: np.ndarray, target: np.ndarray, distance_mm: float) -> RigidTransform:
    """A camera upright in a direction from what it looks at."""
    back = towards / np.linalg.norm(towards)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(back, right), back])
    return RigidTransform.from_numpy(rotation, -rotation @ (target + distance_mm * back))
