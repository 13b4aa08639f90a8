"""Voxel models rendered with a completed lightmap, by texture mapping."""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample

from skylight.cameras.drawing import Drawing, Window, box_edges, window_of
from skylight.cameras.intrinsics import Intrinsics
from skylight.probes.voxel.faces import exposed_faces
from skylight.probes.voxel.lightmap import SLOTS_ACROSS, Lightmap
from skylight.probes.voxel.model import VoxelModel
from skylight.sphere.rigid_transform import RigidTransform
from skylight.transport.raycast import Raycaster


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
        box = box_edges(vertices.amin(0), vertices.amax(0))
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
        pose: RigidTransform,
    ) -> Drawing:
        """By unit ``rays`` of a camera with the pose ``camera_from_world``.

        A pixel is the mean of its s rays; texels are interpolated within their slot.
        """
        height, width, samples, _ = rays.shape
        cells_from_camera = self._inverse @ pose.inverse().matrix()
        turn, eye = cells_from_camera[:3, :3], cells_from_camera[:3, 3]
        # in float32: 1e-5 of a cell where the camera is a hundred cells away
        directions = rays.reshape(-1, 3).float() @ turn.T.float()
        face = self._caster.faces_hit(eye.float().expand(len(directions), 3), directions)
        found = torch.nonzero(face >= 0)[:, 0]
        colours = torch.zeros(height * width * samples, 4)
        colours[found, :3] = self._shading(lightmap, face[found] // 2, eye, directions[found])
        colours[found, 3] = 1
        pixels = colours.reshape(height, width, samples, 4).mean(2)
        return Drawing(radiance=pixels[..., :3], alpha=pixels[..., 3])

    def window(self, pose: RigidTransform, intrinsics: Intrinsics) -> Window:
        """The rectangle of a camera's picture outside of which nothing of the model is seen."""
        return window_of(self._box, pose, intrinsics)

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
