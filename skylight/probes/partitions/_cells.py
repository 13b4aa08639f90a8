"""A design's cells: their regions, and the exact cosine-weighted integrals over them.

The regions are those of a spherical Voronoi diagram, whose polygons are integrated in closed form.
Lambert (1760): a polygon of the unit sphere with arcs of length ``t_k`` about unit poles ``p_k``
(counter-clockwise seen from outside) has ``int w dw = 1/2 sum_k t_k p_k``, so a surface of normal n
that sees all of it gathers ``1/2 sum_k t_k <n, p_k>``. Where the surface's horizon cuts the polygon
the arcs are cut too, and the horizon's own arc, whose pole is n, closes what is left.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree, SphericalVoronoi
from torch import Tensor

from skylight._modes import constant
from skylight.errors import InputError
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.sphere._frame import angle_between

_SAME_VERTEX = 1e-7
_POLYGONS_AT_ONCE = 2**20  # arcs times normals that are looked at together


@dataclass(frozen=True, kw_only=True, eq=False)
class Tessellation:
    """The sphere partitioned by arcs of great circles, each shorter than pi.

    Arc k goes from vertex ``starts[k]`` to ``ends[k]``, with region ``left[k]`` on its left seen
    from outside and ``right[k]`` on the other side.
    """

    vertices: Float[Tensor, "v 3"]
    starts: Int[Tensor, " e"]
    ends: Int[Tensor, " e"]
    left: Int[Tensor, " e"]
    right: Int[Tensor, " e"]
    polygons: tuple[Int[Tensor, " _"], ...]

    @property
    def lengths(self) -> Float[Tensor, " e"]:
        """Arc lengths, radians."""
        return angle_between(self.vertices[self.starts], self.vertices[self.ends])

    @property
    def poles(self) -> Float[Tensor, "e 3"]:
        """Unit normals of the arcs' planes, towards the left."""
        cross = torch.linalg.cross(self.vertices[self.starts], self.vertices[self.ends])
        return cross / cross.norm(dim=1, keepdim=True)

    def pieces(self, labels: Int[Tensor, " r"]) -> Int[Tensor, " r"]:
        """Numbers 0, 1, ... of the connected pieces that regions of one label form."""
        same = labels[self.left] == labels[self.right]
        links = torch.zeros(len(labels), len(labels))
        links[self.left[same], self.right[same]] = 1
        _, piece = connected_components(links.numpy(), directed=False)
        return torch.from_numpy(piece).long()

    def vector_integrals(self) -> Float[Tensor, "r 3"]:
        """int_region w dw for each region."""
        return self._per_region((self.lengths[:, None] * self.poles).T).T / 2

    def solid_angles(self) -> Float[Tensor, " r"]:
        """Of each region, sr: fans of triangles (Van Oosterom and Strackee 1983).

        ``tan(area / 2) = det(a, b, c) / (1 + <a,b> + <b,c> + <c,a>)``
        """
        areas = []
        for polygon in self.polygons:
            corners = self.vertices[polygon]
            a, b, c = corners[:1].expand(len(corners) - 2, 3), corners[1:-1], corners[2:]
            volume = (a * torch.linalg.cross(b, c)).sum(1)
            scale = 1 + (a * b).sum(1) + (b * c).sum(1) + (c * a).sum(1)
            areas.append(2 * torch.atan2(volume, scale).sum())
        return torch.stack(areas)

    def clamped_cosine(self, normals: Float[Tensor, "m 3"]) -> Float[Tensor, "m r"]:
        """int_region max(<n, w>, 0) dw of each unit normal and region, exact."""
        normals = normals.double()
        step = max(1, _POLYGONS_AT_ONCE // len(self.starts))
        return torch.cat([self._clamped_cosine(part) for part in normals.split(step)])

    def _clamped_cosine(self, normals: Float[Tensor, "m 3"]) -> Float[Tensor, "m r"]:
        height = normals @ self.vertices.T
        above = height > 0
        above_start, above_end = above[:, self.starts], above[:, self.ends]
        length = self.lengths
        # what of each arc is above the horizon, and the azimuth at which it crosses it
        lit = torch.where(above_start & above_end, length, 0.0)
        azimuth = torch.zeros_like(lit)
        row, arc = (above_start != above_end).nonzero(as_tuple=True)
        start, end = self.starts[arc], self.ends[arc]
        # |h_b| a + |h_a| b lies on the horizon: towards it from either end of the arc
        from_start, from_end = height[row, end].abs(), height[row, start].abs()
        starts_above = above_start[row, arc]
        near = torch.where(starts_above, from_start, from_end)
        far = torch.where(starts_above, from_end, from_start)
        angle = length[arc]
        lit[row, arc] = torch.atan2(far * torch.sin(angle), near + far * torch.cos(angle))
        across, along = tangents(normals)
        x, y = across @ self.vertices.T, along @ self.vertices.T
        crossing = torch.atan2(
            from_start * y[row, start] + from_end * y[row, end],
            from_start * x[row, start] + from_end * x[row, end],
        )
        # going down ends what is lit on the left, where the horizon's arc begins
        azimuth[row, arc] = torch.where(starts_above, -crossing, crossing)
        turn = self._per_region(azimuth)
        # a convex region's piece of the horizon is shorter than half a turn
        turn = turn - 2 * math.pi * torch.round(turn / (2 * math.pi))
        total = self._per_region(lit * (normals @ self.poles.T)) + turn
        return total.clamp(min=0) / 2

    def _per_region(self, values: Float[Tensor, "m e"]) -> Float[Tensor, "m r"]:
        """Sum over each region's arcs, with a sign for those that run the other way."""
        total = values.new_zeros(len(values), len(self.polygons))
        return total.index_add_(1, self.left, values).index_add_(1, self.right, -values)


def voronoi(seeds: Float[Tensor, "s 3"]) -> Tessellation:
    """The spherical Voronoi diagram of unit seeds whose hull holds the origin.

    Region i belongs to seed i. Where more than three seeds are as close as each other, as in
    symmetric sets, Qhull gives one vertex several times; they are put together.
    """
    diagram = SphericalVoronoi(seeds.numpy())
    same = KDTree(diagram.vertices).query_pairs(_SAME_VERTEX, output_type="ndarray")
    size = len(diagram.vertices)
    links = coo_array((np.ones(len(same)), (same[:, 0], same[:, 1])), shape=(size, size))
    kinds, kind = connected_components(links, directed=False)
    vertices = np.zeros((kinds, 3))
    np.add.at(vertices, kind, diagram.vertices)
    vertices = torch.from_numpy(vertices / np.linalg.norm(vertices, axis=1, keepdims=True))
    polygons = []
    for region, across, along in zip(diagram.regions, *tangents(seeds), strict=True):
        corners = torch.from_numpy(np.unique(kind[region])).long()
        place = vertices[corners]
        polygons.append(corners[torch.atan2(place @ along, place @ across).argsort()])
    arcs: dict[tuple[int, int], int] = {}
    for region, polygon in enumerate(polygons):
        loop = polygon.tolist()
        arcs.update(dict.fromkeys(zip(loop, loop[1:] + loop[:1], strict=True), region))
    one_way = [(a, b) for a, b in arcs if a < b]
    return Tessellation(
        vertices=vertices,
        starts=torch.tensor([a for a, _ in one_way]),
        ends=torch.tensor([b for _, b in one_way]),
        left=torch.tensor([arcs[a, b] for a, b in one_way]),
        right=torch.tensor([arcs[b, a] for a, b in one_way]),
        polygons=tuple(polygons),
    )


def tangents(normals: Float[Tensor, "m 3"]) -> tuple[Float[Tensor, "m 3"], Float[Tensor, "m 3"]]:
    """Two unit vectors that make a right-handed frame with each unit normal."""
    axis = torch.nn.functional.one_hot(normals.abs().argmin(1), 3).to(normals)
    across = torch.linalg.cross(axis, normals)
    across = across / across.norm(dim=1, keepdim=True)
    return across, torch.linalg.cross(normals, across)


# cos of the angle that a merged cell may at most reach from its normal: 89.4 degrees
_LEAST_HEIGHT = 0.01
_CHUNK = 2**16  # directions that are looked at together


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """The n cells of a design; make them with :meth:`of`. float64 throughout.

    ``normals`` (n,3): a cell's one seed (thesis, 4.5), or for merged regions the direction of
    ``int_cell w dw``, in which the cell is seen best.
    """

    design: ProbeDesign
    tessellation: Tessellation
    normals: Float[Tensor, "n 3"]

    @staticmethod
    @constant(16)
    def of(design: ProbeDesign) -> "Cells":
        """The cells of a design, the same object for the same design.

        Raises :class:`InputError` for cells that cannot be built: of unconnected parts, not wholly
        visible from their own face, or enclosing others, whose walls nothing would hold.
        """
        tessellation = voronoi(design.seeds)
        total = _cell_integrals(tessellation, design)
        normals = total / total.norm(dim=1, keepdim=True)
        alone = torch.bincount(design.labels)[design.labels] == 1
        normals[design.labels[alone]] = design.seeds[alone]
        cells = Cells(design=design, tessellation=tessellation, normals=normals)
        cells._check()
        return cells

    @property
    def count(self) -> int:
        return self.design.count

    @property
    def solid_angles(self) -> Float[Tensor, " n"]:
        """Of each cell, sr."""
        return _per_cell(self.tessellation.solid_angles()[None], self.design)[0]

    @property
    def regions(self) -> tuple[Float[Tensor, "_ 3"], ...]:
        """Each seed's Voronoi polygon, unit corners, counter-clockwise seen from outside."""
        t = self.tessellation
        return tuple(t.vertices[polygon] for polygon in t.polygons)

    @property
    def facing(self) -> Float[Tensor, " n"]:
        """int_cell <n_i, w>+ dw: what each face gathers from its own cell under radiance 1."""
        return (self.normals * _cell_integrals(self.tessellation, self.design)).sum(1)

    @property
    def neighbours(self) -> Bool[Tensor, "n n"]:
        """Cells that share a wall."""
        t, label = self.tessellation, self.design.labels
        shared = torch.zeros(self.count, self.count, dtype=torch.bool)
        shared[label[t.left], label[t.right]] = True
        return (shared | shared.T) & ~torch.eye(self.count, dtype=torch.bool)

    def cell_of(self, directions: Float[Tensor, "m 3"]) -> Int[Tensor, " m"]:
        """The cell of each direction (of any length but 0): that of its closest seed."""
        parts = [
            (part.double() @ self.design.seeds.T).argmax(1) for part in directions.split(_CHUNK)
        ]
        return self.design.labels[torch.cat(parts)]

    def clamped_cosine(self, normals: Float[Tensor, "m 3"]) -> Float[Tensor, "m n"]:
        """int_cell <n, w>+ dw of each unit normal and cell, exact; rows sum to pi."""
        return _per_cell(self.tessellation.clamped_cosine(normals), self.design)

    def _check(self) -> None:
        t, label = self.tessellation, self.design.labels
        part = t.pieces(label)
        parts = int(part.max()) + 1
        if parts > self.count:
            first = [int(label[part == i][0]) for i in range(parts)]
            broken = next(i for i in range(self.count) if first.count(i) > 1)
            raise InputError(
                f"the merge {_seeds(self.design, broken)} is not connected: merge only seeds "
                "whose regions share a border"
            )
        for region, polygon in enumerate(t.polygons):
            cell = int(label[region])
            # not below: a cell of the whole sphere has no normal
            if not bool((t.vertices[polygon] @ self.normals[cell] >= _LEAST_HEIGHT).all()):
                raise InputError(
                    f"the merge {_seeds(self.design, cell)} makes a cell that reaches below its "
                    "own face's horizon: merge fewer seeds"
                )
        inside = label[t.left] == label[t.right]
        walls = torch.zeros(len(t.vertices), len(t.vertices))
        walls[t.starts[~inside], t.ends[~inside]] = 1
        at_wall = torch.cat([t.starts[~inside], t.ends[~inside]]).unique()
        pieces, _ = connected_components(walls[at_wall][:, at_wall].numpy(), directed=False)
        if pieces > 1:
            raise InputError(
                "a merged cell goes round others, whose walls nothing would hold: merge fewer seeds"
            )


def _cell_integrals(tessellation: Tessellation, design: ProbeDesign) -> Float[Tensor, "n 3"]:
    """int_cell w dw of each cell."""
    return _per_cell(tessellation.vector_integrals().T, design).T


def _per_cell(values: Float[Tensor, "m s"], design: ProbeDesign) -> Float[Tensor, "m n"]:
    total = values.new_zeros(len(values), design.count)
    return total.index_add_(1, design.labels, values)


def _seeds(design: ProbeDesign, cell: int) -> list[int]:
    return torch.nonzero(design.labels == cell)[:, 0].tolist()
