"""Texture atlases: a scene's surface laid out flat, so that texels can be receivers."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from skylight.errors import DependencyError, InputError
from skylight.probes.partitions.receivers import Receivers
from skylight.probes.partitions.scene import Scene
from skylight.transport.raycast import Hits, Raycaster


@dataclass(frozen=True, kw_only=True, eq=False)
class Atlas:
    """``corners`` (f,3,2): where the corners of each triangle lie in a square of ``size`` texels.

    u to the right and v up, in 0..1. Triangles must not overlap there.
    """

    corners: Float[Tensor, "f 3 2"]
    size: int

    def __post_init__(self) -> None:
        if self.size < 4:
            raise InputError(f"an atlas has 4 texels or more along its sides, got {self.size}")
        low, high = float(self.corners.min()), float(self.corners.max())
        if not (low >= -1e-6 and high <= 1 + 1e-6):
            raise InputError(
                f"the texture coordinates reach from {low:g} to {high:g}, so the texture repeats "
                "and its texels are no places: make an atlas of charts"
            )

    @staticmethod
    def of_file(scene: Scene, size: int) -> "Atlas":
        """With the texture coordinates that the scene has."""
        if scene.uv is None:
            raise InputError("the scene has no texture coordinates: make an atlas of charts")
        return Atlas(corners=scene.uv[scene.faces], size=size)

    @staticmethod
    def of_charts(scene: Scene, size: int) -> "Atlas":
        """Cut into charts without overlaps, by xatlas; a second for some thousand triangles."""
        try:
            import xatlas  # optional
        except ImportError as error:
            raise DependencyError(
                "atlases of charts need xatlas: pip install 'skylight[atlas]'"
            ) from error
        made: Any = xatlas.Atlas()
        made.add_mesh(scene.vertices.float().numpy(), scene.faces.numpy().astype(np.uint32))
        packing = xatlas.PackOptions()
        packing.resolution = size
        packing.padding = 3  # of which scaling to ``size`` leaves 2 or more
        made.generate(pack_options=packing)
        _, faces, uv = made[0]
        if made.atlas_count != 1 or len(faces) != len(scene.faces):
            raise InputError(
                f"xatlas cannot lay the scene out in one picture of {size} x {size} texels: give "
                "the atlas more, or simplify the scene"
            )
        corners = torch.from_numpy(np.array(uv, np.float64)[np.array(faces, np.int64)])
        # its page is what it needed, some fifth more or less than ``size``, and not square
        corners *= torch.tensor([made.width, made.height]) / max(made.width, made.height)
        # a texel's margin: textures repeat, and what is read at one border would meet the other
        corners = (1 + (size - 2) * corners) / size
        return Atlas(corners=corners, size=size)

    @cached_property
    def covered(self) -> Bool[Tensor, "h w"]:
        """Texels whose centres lie in a triangle; row 0 is the upper edge, v = 1."""
        return (self._hits.face >= 0).reshape(self.size, self.size)

    def receivers(self, scene: Scene) -> Receivers:
        """The covered texels, in rows."""
        found = self._hits.face >= 0
        return Receivers.on_surface(scene, self._hits.face[found], self._hits.barycentric[found])

    def image(self, values: Float[Tensor, "m *c"]) -> Float[Tensor, "h w *c"]:
        """Values of the covered texels as a texture; others get that of the closest.

        So that looking it up between texels meets no black at the charts' borders.
        """
        covered = self.covered.numpy()
        if not covered.any():
            raise InputError(f"no texel of {self.size} x {self.size} lies in a triangle: use more")
        closest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
        row, column = np.asarray(closest)
        number = np.zeros(covered.shape, np.int64)
        number[covered] = np.arange(int(covered.sum()))
        return values[torch.from_numpy(number[row, column])]

    @cached_property
    def _hits(self) -> Hits:
        """Which triangle holds each texel's centre: rays from above on the layout."""
        flat = torch.nn.functional.pad(self.corners.double().reshape(-1, 2), (0, 1))
        caster = Raycaster(flat, torch.arange(len(flat)).reshape(-1, 3))
        along = (torch.arange(self.size, dtype=torch.float64) + 0.5) / self.size
        v, u = torch.meshgrid(along.flip(0), along, indexing="ij")
        starts = torch.stack([u, v, torch.ones_like(u)], 2).reshape(-1, 3)
        return caster.intersect(starts, torch.tensor([[0.0, 0, -1]]))
