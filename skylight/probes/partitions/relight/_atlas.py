"""Where on a scene transfer is computed: vertices of small triangles, or texels of an atlas.

An atlas lays the surface out flat, so that texels can be receivers; without one, triangles are
subdivided, for light that varies within them.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError, not_installed
from skylight.probes.partitions.relight._scene import Scene
from skylight.transport._rays import Hits, Raycaster
from skylight.transport._render import GBuffer, lift

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
            raise not_installed("xatlas", "an atlas of charts") from error
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


MOST_TRIANGLES = 4_000_000


def refined(scene: Scene, longest_edge: float) -> Scene:
    """The same surface with no edge longer than ``longest_edge``, without gaps.

    All long edges are halved at once, so that triangles on both sides of an edge agree.
    """
    if not longest_edge > 0:
        raise InputError(f"the longest edge must be above 0, got {longest_edge:g}")
    while True:
        ends = torch.stack([scene.faces, scene.faces.roll(-1, 1)], 2).reshape(-1, 2).sort(1)[0]
        count = len(scene.vertices)
        edges, number = (ends[:, 0] * count + ends[:, 1]).unique(return_inverse=True)
        edges = torch.stack([edges // count, edges % count], 1)
        length = (scene.vertices[edges[:, 0]] - scene.vertices[edges[:, 1]]).norm(dim=1)
        long = length > longest_edge
        if not bool(long.any()):
            return scene
        middles = torch.full((len(edges),), -1)
        middles[long] = count + torch.arange(int(long.sum()))
        # no triangle of such edges is larger than the equilateral one
        least = scene.area / (math.sqrt(0.1875) * longest_edge**2)
        if max(least, len(scene.faces)) > MOST_TRIANGLES:
            raise InputError(
                f"edges of {longest_edge:g} at most take more than {MOST_TRIANGLES} triangles: "
                "allow longer ones"
            )
        halves = edges[long]
        scene = replace(
            scene,
            vertices=_with_middles(scene.vertices, halves),
            faces=_split(scene.faces, middles[number].reshape(-1, 3)),
            normals=normalize(_with_middles(scene.normals, halves), dim=1),
            albedo=_with_middles(scene.albedo, halves),
            uv=None if scene.uv is None else _with_middles(scene.uv, halves),
        )


def _with_middles(values: Tensor, ends: Int[Tensor, "e 2"]) -> Tensor:
    return torch.cat([values, values[ends].mean(1)])


def _split(faces: Int[Tensor, "f 3"], middles: Int[Tensor, "f 3"]) -> Int[Tensor, "g 3"]:
    """Triangles with the middles (or -1) of the edges 01, 12 and 20, cut there."""
    cut = middles >= 0
    count = cut.sum(1)
    # one cut edge comes first, an uncut one beside two cut ones last
    turn = torch.where(count == 1, cut.int().argmax(1), ((~cut).int().argmax(1) + 1) % 3)
    turn = torch.where((count == 1) | (count == 2), turn, 0)
    index = (torch.arange(3) + turn[:, None]) % 3
    a, b, c = faces.gather(1, index).T
    ab, bc, ca = middles.gather(1, index).T
    pieces = {
        0: [(a, b, c)],
        1: [(a, ab, c), (ab, b, c)],
        2: [(ab, b, bc), (a, ab, c), (ab, bc, c)],
        3: [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)],
    }
    return torch.cat(
        [torch.stack(p, 1)[count == cuts] for cuts, each in pieces.items() for p in each]
    )
