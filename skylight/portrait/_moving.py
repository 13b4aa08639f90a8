"""A head that turns: what its skin sees is traced once, in one pose, and carried with it.

What reaches skin from a direction of the head's own frame hardly changes while the head turns:
nose and brows turn with it, and only bust, which turns less, and expressions do not. So rays are
cast from the vertices of the skin in one keyframe, and in every other frame the light is turned
into that pose's frame. What that leaves out is the change of the shadows that an expression
changes, and of the bust's on the neck.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import normalize

from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel
from skylight.faces._observe import SKIN_SPECULAR, skin_seen
from skylight.portrait._surface import (
    FACE_PX,
    SKIN,
    PersonMesh,
    Shading,
    reflected_transport,
    scaled,
    softened,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._matrix import SeenDirections
from skylight.transport._rays import Raycaster
from skylight.transport._render import SMOOTH_HEIGHT, GBuffer, Specular, rasterize, vertex_normals
from skylight.transport._visibility import adaptive_visibility
from skylight.work._progress import Progress


@dataclass(frozen=True, kw_only=True)
class MovingHead:
    """``sight`` is what the vertices ``lit`` (v,) of the head model see where the head is turned by
    ``rotation``; pictures are scaled by ``scale``."""

    rotation: Float[ndarray, "3 3"]
    lit: Int[Tensor, " v"]
    sight: SeenDirections
    scale: float

    @staticmethod
    def of(
        fit: FaceFit,
        hair: Float[ndarray, "h w"],
        *,
        face_px: int = FACE_PX,
        workers: int = 1,
        progress: Progress | None = None,
    ) -> "MovingHead":
        """Traced in the pose of ``fit``, whose face is at most ``face_px`` high in pictures of
        shading; ``hair`` is how likely a pixel of its frame shows hair, which hides light.

        Memory: v * 2048 bytes, 9 MB of 4,500 vertices.
        """
        model, mesh = HeadModel.load(), PersonMesh.of(fit, hair)
        lit = torch.from_numpy(np.flatnonzero(np.isin(model.regions, SKIN)))
        normals = vertex_normals(
            mesh.vertices[: len(model.mean)], torch.from_numpy(model.faces.copy())
        )
        sight = adaptive_visibility(
            mesh.vertices[lit],
            normals[lit],
            normals[lit],
            Raycaster(mesh.vertices, mesh.faces),
            SMOOTH_HEIGHT,
            workers=workers,
            progress=progress,
        )
        height = float(np.ptp(skin_seen(model, fit)[:, 1]))
        return MovingHead(
            rotation=fit.rotation, lit=lit, sight=sight, scale=min(1.0, face_px / height)
        )

    def at(self, fit: FaceFit, world_from_camera: Float[ndarray, "3 3"]) -> "PosedPerson":
        """In another pose, before a camera that is turned so."""
        model, mesh = HeadModel.load(), PersonMesh.of(fit, None)
        camera = scaled(fit.camera, self.scale)
        surface = rasterize(camera, mesh.vertices, mesh.faces, Raycaster(mesh.vertices, mesh.faces))
        return PosedPerson(
            head=self,
            surface=surface,
            corners=mesh.faces[surface.faces],
            vertices=torch.from_numpy(fit.vertices),
            regions=mesh.regions_at(surface),
            face_px=self.scale * float(np.ptp(skin_seen(model, fit)[:, 1])),
            turned=torch.from_numpy(fit.rotation @ self.rotation.T),
            world_from_camera=torch.from_numpy(np.ascontiguousarray(world_from_camera)),
        )


@dataclass(frozen=True, kw_only=True)
class PosedPerson:
    """A :class:`~skylight.portrait._surface.LitPerson` whose light is in the world's frame.

    ``corners`` (m,3) are the vertices about each pixel; ``turned`` is the rotation from the pose
    that was traced to this one, in the camera's frame.
    """

    head: MovingHead
    surface: GBuffer
    corners: Int[Tensor, "m 3"]
    vertices: Float[Tensor, "n 3"]
    regions: UInt8[Tensor, " m"]
    face_px: float
    turned: Float[Tensor, "3 3"]
    world_from_camera: Float[Tensor, "3 3"]

    def shade(self, light: EnvironmentMap, specular: Specular | None) -> Shading:
        """Direct light with shadows at the skin's vertices, interpolated; 0 elsewhere.

        ``sum_w V <n, w>+ L dw / pi``, and so with f_s for 1 / pi, that of skin.
        """
        assert specular in (None, SKIN_SPECULAR)  # whose matrix is kept for the next light
        radiance = softened(light, self.world_from_camera @ self.turned).flat.float()
        needed, count = self._seen, len(self.head.lit)
        sent = torch.zeros(count + 1, 6)  # the last of what is no skin
        sent[needed, :3] = self._transport @ radiance
        if specular is not None:
            sent[needed, 3:] = self._reflected @ radiance
        corners = self._rows[self.corners]
        shown = (sent[corners] * self.surface.barycentric[..., None].float()).sum(1)
        return Shading(diffuse=shown[:, :3], specular=shown[:, 3:])

    @cached_property
    def _rows(self) -> Int[Tensor, " n"]:
        """Which row of ``sight`` a vertex has; one too many where it has none."""
        lit = self.head.lit
        rows = torch.full((int(max(self.corners.max(), lit.max())) + 1,), len(lit))
        rows[lit] = torch.arange(len(lit))
        return rows

    @cached_property
    def _seen(self) -> Int[Tensor, " v"]:
        """Rows of the vertices that are in the picture."""
        rows = self._rows[self.corners.unique()]
        return rows[rows < len(self.head.lit)]

    @cached_property
    def _transport(self) -> Float[Tensor, "v n"]:
        return self.head.sight[self._seen]

    @cached_property
    def _reflected(self) -> Float[Tensor, "v n"]:
        """pi T f_s: 8 kB a vertex, for every light."""
        head, rows = self.head, self._seen
        # towards the camera, in the frame of the pose that was traced
        views = (-normalize(self.vertices[head.lit], dim=1) @ self.turned).float()
        normals, towards = head.sight.normals.float(), head.sight.grid.directions.float()
        return reflected_transport(self._transport, normals[rows], views[rows], towards)
