"""A design's cells: their regions, and the exact cosine-weighted integrals over them."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.partitions.polygons import Tessellation, voronoi
from skylight.probes.partitions.seeds import ProbeDesign

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
    @lru_cache(maxsize=16)
    def of(design: ProbeDesign) -> "Cells":
        """The cells of a design, the same object for the same design.

        Raises :class:`InputError` for cells that cannot be built: of unconnected parts, not wholly
        visible from their own face, or enclosing others, whose walls nothing would hold.
        """
        tessellation = voronoi(design.seeds)
        total = _per_cell(tessellation.vector_integrals().T, design).T
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
        return (self.normals * self._vector_integrals()).sum(1)

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
        """int_cell <n, w>+ dw of each unit normal and cell, exact; rows sum to pi.

        See :mod:`skylight.probes.partitions.polygons`.
        """
        return _per_cell(self.tessellation.clamped_cosine(normals), self.design)

    def _vector_integrals(self) -> Float[Tensor, "n 3"]:
        return _per_cell(self.tessellation.vector_integrals().T, self.design).T

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


def _per_cell(values: Float[Tensor, "m s"], design: ProbeDesign) -> Float[Tensor, "m n"]:
    total = values.new_zeros(len(values), design.count)
    return total.index_add_(1, design.labels, values)


def _seeds(design: ProbeDesign, cell: int) -> list[int]:
    return torch.nonzero(design.labels == cell)[:, 0].tolist()
