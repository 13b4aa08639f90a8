"""Voxel models drawn with a completed lightmap: texture mapping, nothing more."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample, normalize

from skylight.probes.capture.intrinsics import FLIP, Intrinsics
from skylight.probes.capture.pose import Pose
from skylight.probes.voxel.faces import exposed_faces
from skylight.probes.voxel.lightmap import SLOTS_ACROSS, Lightmap
from skylight.probes.voxel.model import VoxelModel
from skylight.transport.camera import Camera
from skylight.transport.raycast import Raycaster

_BENT_PX = 4  # by which distortion bends an edge between two of the places looked at
Window = tuple[slice, slice]  # rows and columns of a picture
WHOLE: Window = (slice(None), slice(None))


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """What a camera sees of a model: linear ``radiance`` and ``alpha``, the share covered."""

    radiance: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"]

    def over(self, background: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """In front of a linear picture; radiance is already weighed by alpha."""
        return self.radiance + (1 - self.alpha[..., None]) * background


def camera_rays(camera: Camera, samples: int = 1) -> Float[Tensor, "h w s 3"]:
    """Unit directions in the camera's frame through ``samples`` x ``samples`` places of a pixel."""
    height, width = camera.height, camera.width
    fine = Camera(
        focal_px=camera.focal_px * samples,
        width=width * samples,
        height=height * samples,
        center_px=(camera.center_px[0] * samples, camera.center_px[1] * samples),
    )
    rays = fine.rays().reshape(height, samples, width, samples, 3)
    return rays.transpose(1, 2).reshape(height, width, samples**2, 3)


def lens_rays(
    intrinsics: Intrinsics, samples: int = 1, window: Window | None = None
) -> Float[Tensor, "h w s 3"]:
    """The same for a real camera's own picture, distortion and all, or for a window of it."""
    rows, columns = window or (slice(0, intrinsics.height), slice(0, intrinsics.width))
    offset = (np.arange(samples) + 0.5) / samples - 0.5
    row = np.arange(rows.start, rows.stop)[:, None, None, None] + offset[:, None]
    column = np.arange(columns.start, columns.stop)[:, None, None] + offset
    row, column = np.broadcast_arrays(row, column)  # (h, w, samples, samples)
    pixels = np.stack([column, row], -1).reshape(-1, 2).astype(np.float64)
    ideal = intrinsics.undistort_points(pixels)
    x = (ideal[:, 0] - intrinsics.cx) / intrinsics.fx
    y = (ideal[:, 1] - intrinsics.cy) / intrinsics.fy
    rays = torch.from_numpy(np.stack([x, y, np.ones_like(x)], 1) @ FLIP)
    return normalize(rays, dim=1).reshape(*row.shape[:2], samples**2, 3)


class VoxelRenderer:
    """Draws one model from anywhere; its faces and the ray caster are made once.

    ``to_world`` (4,4) takes the model's cells to the world in which cameras are placed; without
    it, cells are the world's units.
    """

    def __init__(self, model: VoxelModel, to_world: Float[Tensor, "4 4"] | None = None) -> None:
        self.faces = exposed_faces(model)
        matrix = torch.eye(4, dtype=torch.float64) if to_world is None else to_world.double()
        self._inverse = torch.linalg.inv(matrix)
        vertices, triangles = self.faces.triangles()
        self._caster = Raycaster(vertices, triangles)
        box = _box_edges(vertices.amin(0), vertices.amax(0))
        self._box = (box @ matrix[:3, :3].T + matrix[:3, 3]).numpy()
        corners = self.faces.corners
        self._origin = corners[:, 3]  # left, forward
        right, back = corners[:, 2] - corners[:, 3], corners[:, 0] - corners[:, 3]
        self._frame = torch.stack([right, back, torch.linalg.cross(back, right)], 1)
        self._slot = self.faces.slot

    def draw(
        self,
        lightmap: Lightmap,
        rays: Float[Tensor, "h w s 3"],
        rotation: Float[Tensor, "3 3"],
        translation: Float[Tensor, "3"],
    ) -> Drawing:
        """By unit ``rays`` of a camera for which world points stand at ``rotation @ x + t``.

        A pixel is the mean of its s rays; texels are interpolated within their slot.
        """
        height, width, samples, _ = rays.shape
        turn = self._inverse[:3, :3] @ rotation.double().T
        eye = self._inverse[:3, 3] - turn @ translation.double()
        # in float32: 1e-5 of a cell where the camera is a hundred cells away
        directions = rays.reshape(-1, 3).float() @ turn.T.float()
        face = self._caster.faces_hit(eye.float().expand(len(directions), 3), directions)
        found = torch.nonzero(face >= 0)[:, 0]
        colours = torch.zeros(height * width * samples, 4)
        colours[found, :3] = self._shading(lightmap, face[found] // 2, eye, directions[found])
        colours[found, 3] = 1
        pixels = colours.reshape(height, width, samples, 4).mean(2)
        return Drawing(radiance=pixels[..., :3], alpha=pixels[..., 3])

    def window(self, pose: Pose, intrinsics: Intrinsics) -> Window:
        """The rectangle of a camera's picture outside of which nothing of the model is seen."""
        height, width = intrinsics.height, intrinsics.width
        ahead = -pose.to_camera(self._box)[:, 2]
        pixels = pose.project(self._box, intrinsics)
        # what is beside or behind the camera, or far outside, has no place in the picture to go by
        if ahead.min() <= 0 or np.abs(pixels - [width / 2, height / 2]).max() > 2 * width:
            return slice(0, height), slice(0, width)
        low = np.floor(pixels.min(0)).astype(int) - _BENT_PX
        high = np.ceil(pixels.max(0)).astype(int) + _BENT_PX + 1
        (left, top), (right, bottom) = low.clip(0), high.clip(0)
        return slice(min(top, height), min(bottom, height)), slice(
            min(left, width), min(right, width)
        )

    def _shading(
        self,
        lightmap: Lightmap,
        face: Int[Tensor, " r"],
        eye: Float[Tensor, "3"],
        directions: Float[Tensor, "r 3"],
    ) -> Float[Tensor, "r 3"]:
        """Bilinear between the centres of a slot's texels, constant beyond the outermost.

        In a face's own frame (right, back, out), the ray from e along d meets it at
        ``e - d e_out / d_out``.
        """
        n = lightmap.size
        along = torch.einsum("rij,rj->ri", self._frame.float()[face], directions)
        start = torch.einsum("fij,fj->fi", self._frame, eye - self._origin).float()[face]
        place = (start[:, :2] - start[:, 2:] / along[:, 2:] * along[:, :2]) * n - 0.5
        place = place.clamp(0, n - 1)
        slot = self._slot[face]
        corner = torch.stack([slot % SLOTS_ACROSS, slot // SLOTS_ACROSS], 1) * n
        image = lightmap.image().permute(2, 0, 1).float()
        size = torch.tensor([image.shape[2], image.shape[1]])
        grid = 2 * (corner + place) / (size - 1) - 1  # the next slot has no weight
        return grid_sample(image[None], grid[None, None], align_corners=True)[0, :, 0].T


def _box_edges(low: Float[Tensor, "3"], high: Float[Tensor, "3"]) -> Float[Tensor, "n 3"]:
    """Places along the twelve edges of a box, 17 on each."""
    share = torch.linspace(0, 1, 17, dtype=torch.float64)
    grids = []
    for axis in range(3):
        along = [torch.tensor([0.0, 1.0], dtype=torch.float64)] * 3
        along[axis] = share
        grids.append(torch.cartesian_prod(*along))
    return low + torch.cat(grids) * (high - low)


def looking_at(
    eye: Float[Tensor, "3"], target: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "3 3"], Float[Tensor, "3"]]:
    """(rotation, translation) of a camera at ``eye`` that looks at ``target``, +Y up."""
    back = normalize(eye.double() - target.double(), dim=0)
    # straight up or down, the picture's top is -Z
    steep = abs(float(back[1])) > 1 - 1e-9
    up = torch.tensor([0.0, 0.0, -1.0] if steep else [0.0, 1.0, 0.0], dtype=torch.float64)
    right = normalize(torch.linalg.cross(up, back), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(back, right), back])
    return rotation, -rotation @ eye.double()
