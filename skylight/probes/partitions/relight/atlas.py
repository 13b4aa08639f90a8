"""Texture atlases: a scene's surface laid out flat, so that texels can be receivers."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from skylight.errors import DependencyError, InputError
from skylight.probes.partitions.relight.receivers import Receivers
from skylight.probes.partitions.relight.scene import Scene
from skylight.transport.raycast import Hits, Raycaster

MOST_TEXELS = 4096  # along each side
# a triangle has room if its share of the texels is a thousandth of its share of the surface
_LEAST_ROOM, _MOST_WITHOUT = 1e-3, 0.01
_STACK = 1e-3  # high: higher ones slow the raycaster down
_INSIDE = 1e-3  # barycentric: what lies on an edge lies in both of its triangles


class UnusableLayout(InputError):
    """Texture coordinates by which a texel is no single place of the surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Atlas:
    """``corners`` (f,3,2): where the corners of each triangle lie in a square of ``size`` texels.

    u to the right and v up, in 0..1. Triangles must not overlap there: :attr:`overlapping`.
    """

    corners: Float[Tensor, "f 3 2"]
    size: int

    def __post_init__(self) -> None:
        if not 4 <= self.size <= MOST_TEXELS:
            raise InputError(
                f"an atlas has 4 texels or more along its sides, and {MOST_TEXELS} at most; got "
                f"{self.size}"
            )
        low, high = float(self.corners.min()), float(self.corners.max())
        if not (low >= -1e-6 and high <= 1 + 1e-6):
            raise UnusableLayout(
                f"the texture coordinates reach from {low:g} to {high:g}, so the texture repeats "
                "and its texels are no places: make an atlas of charts"
            )

    @staticmethod
    def of_file(scene: Scene, size: int) -> "Atlas":
        """With the texture coordinates that the scene has.

        Raises
        ------
        UnusableLayout
            It has none, they repeat or overlap, or give some of the surface no room.
        """
        if scene.uv is None:
            raise UnusableLayout("the scene has no texture coordinates: make an atlas of charts")
        atlas = Atlas(corners=scene.uv[scene.faces], size=size)
        cramped = atlas._without_room(scene)
        if cramped > _MOST_WITHOUT:
            raise UnusableLayout(
                f"the texture coordinates give {100 * cramped:.0f} % of the surface next to no "
                "room: make an atlas of charts"
            )
        double = int(atlas.overlapping.sum())
        if double:
            raise UnusableLayout(
                f"the texture coordinates overlap: {double} texels of {size} x {size} would be "
                "several places: make an atlas of charts"
            )
        return atlas

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
    def overlapping(self) -> Bool[Tensor, "h w"]:
        """Texels whose centres lie in several triangles."""
        above, below = self._hits, self._cast(from_above=False)
        differ = (above.face >= 0) & (above.face != below.face)
        inside = torch.minimum(above.barycentric.amin(1), below.barycentric.amin(1)) > _INSIDE
        return (differ & inside).reshape(self.size, self.size)

    @cached_property
    def covered(self) -> Bool[Tensor, "h w"]:
        """Texels whose centres lie in a triangle; row 0 is the upper edge, v = 1."""
        return (self._hits.face >= 0).reshape(self.size, self.size)

    def receivers(self, scene: Scene) -> Receivers:
        """The covered texels, in rows."""
        found = self._hits.face >= 0
        return Receivers.on_surface(scene, self._hits.face[found], self._hits.barycentric[found])

    def vertices(
        self, scene: Scene
    ) -> tuple[Int[Tensor, " k"], Float[Tensor, "k 2"], Int[Tensor, "f 3"]]:
        """(which of the scene's vertices, where in the atlas, triangles), split between charts."""
        known = torch.cat([scene.faces.reshape(-1, 1), self.corners.double().reshape(-1, 2)], 1)
        different, number = known.unique(dim=0, return_inverse=True)
        return different[:, 0].long(), different[:, 1:], number.reshape(-1, 3)

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

    def _without_room(self, scene: Scene) -> float:
        """The share of the surface in triangles that have too little of the texture."""
        a, b, c = scene.vertices[scene.faces].unbind(1)
        area = torch.linalg.cross(b - a, c - a).norm(dim=1)
        a, b, c = torch.nn.functional.pad(self.corners.double(), (0, 1)).unbind(1)
        room = torch.linalg.cross(b - a, c - a).norm(dim=1) / 2
        share = area / area.sum()
        return float(share[room < _LEAST_ROOM * share].sum())

    @cached_property
    def _hits(self) -> Hits:
        """Which triangle holds each texel's centre."""
        return self._cast(from_above=True)

    def _cast(self, *, from_above: bool) -> Hits:
        """Rays on the layout, in which each triangle lies higher than the one before it."""
        count = len(self.corners)
        height = _STACK * torch.arange(count, dtype=torch.float64) / count
        height = height[:, None, None].expand(count, 3, 1)
        stack = torch.cat([self.corners.double(), height], 2).reshape(-1, 3)
        caster = Raycaster(stack, torch.arange(3 * count).reshape(-1, 3))
        along = (torch.arange(self.size, dtype=torch.float64) + 0.5) / self.size
        v, u = torch.meshgrid(along.flip(0), along, indexing="ij")
        start, way = (2 * _STACK, -1.0) if from_above else (-_STACK, 1.0)
        starts = torch.stack([u, v, torch.full_like(u, start)], 2).reshape(-1, 3)
        return caster.intersect(starts, torch.tensor([[0.0, 0, way]]))
