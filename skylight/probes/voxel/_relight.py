"""Voxel models drawn with a completed lightmap: in a camera's picture, as a .glb file, and live."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor
from torch.nn.functional import grid_sample

from skylight.probes._capture import LiveView
from skylight.probes._unlit_glb import baked_material, write_unlit_glb
from skylight.probes.cameras._drawing import (
    Drawing,
    Window,
    box_edges,
    composite,
    lens_rays,
    window_of,
)
from skylight.probes.cameras._files import Setup
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._live import Clock
from skylight.probes.voxel._assembly import PlacedProbe
from skylight.probes.voxel._captured import LightmapCapture
from skylight.probes.voxel._lightmap import SLOTS_ACROSS, Lightmap, texture_coordinates
from skylight.probes.voxel._model import VoxelModel, exposed_faces
from skylight.probes.voxel._reconstruct import SlotReconstruction
from skylight.sphere._rotation import RigidTransform
from skylight.transport._rays import Raycaster


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


def write_glb(
    path: Path,
    model: VoxelModel,
    lightmap: Lightmap,
    *,
    voxel_size: float = 1.0,
    exposure: float = 1.0,
) -> None:
    """glTF 2.0 with the lightmap as texture of an unlit material (KHR_materials_unlit).

    ``voxel_size`` is in glTF's metres. ``exposure`` scales the light; what exceeds 1 is clipped,
    as textures hold no more.
    """
    import trimesh
    from trimesh.visual import TextureVisuals

    faces = exposed_faces(model)
    vertices, triangles = faces.triangles()
    uv = texture_coordinates(faces.orientation, faces.configuration, inset=0.5 / lightmap.size)
    material = baked_material(lightmap.png(exposure))
    mesh = trimesh.Trimesh(
        vertices.numpy() * voxel_size,
        triangles.numpy(),
        visual=TextureVisuals(uv=uv.reshape(-1, 2).numpy(), material=material),
        process=False,
    )
    write_unlit_glb(path, mesh)


class VoxelLiveView(LiveView):
    """Camera frames to frames with the model in them, as soon as every side of the probe was seen.

    ``to_board`` (4,4) takes the model's cells to millimetres of the board; ``reconstruction`` makes
    the weights for the slots that are known, which happens again whenever there are more.
    """

    counted = "slots"

    def __init__(
        self,
        setup: Setup,
        *,
        probe: PlacedProbe,
        model: VoxelModel,
        to_board: Float[Tensor, "4 4"],
        reconstruction: Callable[[Lightmap], SlotReconstruction],
    ) -> None:
        super().__init__(setup)
        self._capture = LightmapCapture(probe)
        self._renderer = VoxelRenderer(model, to_board)
        self._rays = lens_rays(setup.intrinsics)
        self._make = reconstruction
        self._weights: SlotReconstruction | None = None
        self._completed: Lightmap | None = None

    @property
    def known(self) -> int:
        return self._capture.slots

    @property
    def lightmap(self) -> Lightmap:
        """What was captured so far."""
        return self._capture.lightmap()

    def draw(
        self, image: UInt8[np.ndarray, "h w 3"], pose: RigidTransform, clock: Clock
    ) -> UInt8[np.ndarray, "h w 3"] | None:
        lens, response = self.setup.intrinsics, self.setup.response
        taken = self._capture.add_photo(image, response, pose, lens, compare=False)
        clock.mark("capture")
        if taken:
            self._complete()
        clock.mark("reconstruct")
        if self._completed is None:
            return None
        window = self._renderer.window(pose, lens)
        drawing = self._renderer.draw(self._completed, self._rays[window], pose)
        picture = composite(image, drawing, response, window)
        clock.mark("draw")
        return picture

    def _complete(self) -> None:
        lightmap = self._capture.lightmap()
        if not bool(lightmap.known.any(1).all()):
            return
        if self._weights is None or not torch.equal(self._weights.known, lightmap.known):
            self._weights = self._make(lightmap)
        self._completed = self._weights.complete(lightmap)
