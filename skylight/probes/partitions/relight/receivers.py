"""Surface points at which transfer is computed."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.probes.partitions.relight.scene import Scene
from skylight.transport.gbuffer import GBuffer, lift

# Of the way from a vertex to the middles of its triangles: at a wall's foot, rays must start
# before the wall.
_INWARD = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Receivers:
    """m points: where rays start (before they are lifted), unit normals, albedo.

    ``normals`` are the cosine's; ``geometric_normals`` lift the starts off the surface.
    """

    positions: Float[Tensor, "m 3"]
    normals: Float[Tensor, "m 3"]
    geometric_normals: Float[Tensor, "m 3"]
    albedo: Float[Tensor, "m 3"]

    def __post_init__(self) -> None:
        if not all(bool(values.isfinite().all()) for values in vars(self).values()):
            raise InputError("receivers have values that are NaN or infinite")

    def __len__(self) -> int:
        return len(self.positions)

    @staticmethod
    def at_vertices(scene: Scene) -> "Receivers":
        """The scene's vertices, seen from the front."""
        middles = scene.vertices[scene.faces].mean(1)
        total = torch.zeros(len(scene.vertices), 4, dtype=torch.float64)
        for corner in scene.faces.T:
            total.index_add_(0, corner, torch.nn.functional.pad(middles, (0, 1), value=1))
        inward = total[:, :3] / total[:, 3:].clamp(min=1) - scene.vertices
        inward = torch.where(total[:, 3:] > 0, inward, 0)
        # along the surface: on round bodies the middles lie below it
        inward -= (inward * scene.normals).sum(1, keepdim=True) * scene.normals
        return Receivers(
            positions=scene.vertices + _INWARD * inward,
            normals=scene.normals,
            geometric_normals=scene.normals,
            albedo=scene.albedo,
        )

    @staticmethod
    def on_surface(
        scene: Scene, faces: Int[Tensor, " m"], barycentric: Float[Tensor, "m 3"]
    ) -> "Receivers":
        """Points of the scene's triangles, seen from the front."""
        corners = scene.faces[faces]
        corner_normals = scene.normals[corners]
        places = scene.vertices[corners]
        position = (barycentric[:, :, None] * places).sum(1)
        return Receivers(
            positions=lift(position, barycentric, places, corner_normals),
            normals=normalize(scene.interpolated(scene.normals, faces, barycentric), dim=1),
            geometric_normals=scene.face_normals[faces],
            albedo=scene.albedo_at(faces, barycentric),
        )

    @staticmethod
    def seen(gbuffer: GBuffer, scene: Scene) -> "Receivers":
        """What a camera sees of the scene, on the side that it sees."""
        return Receivers(
            positions=gbuffer.origins,
            normals=gbuffer.normals,
            geometric_normals=gbuffer.geometric_normals,
            albedo=scene.albedo_at(gbuffer.faces, gbuffer.barycentric),
        )

    def behind(self, which: Int[Tensor, " k"]) -> "Receivers":
        """Some of them, seen from the back."""
        return Receivers(
            positions=self.positions[which],
            normals=-self.normals[which],
            geometric_normals=-self.geometric_normals[which],
            albedo=self.albedo[which],
        )

    @staticmethod
    def joined(first: "Receivers", second: "Receivers") -> "Receivers":
        return Receivers(**{k: torch.cat([v, getattr(second, k)]) for k, v in vars(first).items()})
