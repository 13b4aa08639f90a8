"""Which voxels of a model hold one another, and in which order they go together.

Voxels are joined as a tree: each but the first is pressed onto a collar of its parent, by one
straight movement. The first is pressed onto the foot that holds the pole, below it.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from skylight.errors import InputError
from skylight.probes.fabrication._parts import PrintSizes
from skylight.probes.voxel._model import NORMALS, VoxelModel

EXPOSED, OPEN, COLLAR, FLUSH = range(4)  # what a side is: open to the parent, collar to a child
DOWN = 3  # of the sides +x, -x, +y, -y, +z, -z
_MOST_CELLS = 1000
_RANDOM_TREES = 100
_TOUCH_MM = 1e-9


@dataclass(frozen=True, kw_only=True)
class PressFit:
    """Voxels in the order in which they are put together.

    ``parents`` are places in ``cells``, -1 for the foot; ``toward_parent`` and ``sides`` count
    sides as :data:`~skylight.probes.voxel._model.NORMALS` does.
    """

    cells: Int[np.ndarray, "n 3"]
    parents: Int[np.ndarray, " n"]
    toward_parent: Int[np.ndarray, " n"]
    sides: Int[np.ndarray, "n 6"]

    def __len__(self) -> int:
        return len(self.cells)

    def children(self, part: int) -> list[int]:
        return np.flatnonzero(self.parents == part).tolist()


def opposite(side: int) -> int:
    """The side across."""
    return side ^ 1


def plan_press_fit(model: VoxelModel, sizes: PrintSizes) -> PressFit:
    """A tree of joints, and an order in which every part slides on without meeting another.

    Trees are tried: breadth first with the vertical or the level directions first, then random
    ones. An order is found backwards, by taking off any part that can be pulled away from its
    parent; as taking off never adds an obstacle, none exists where that ends early.
    """
    cells = np.argwhere(model.occupied)
    if len(cells) > _MOST_CELLS:
        raise InputError(
            f"a printed model has at most {_MOST_CELLS} voxels, this one {len(cells)}: lower its "
            "resolution"
        )
    neighbours = _neighbours(cells)
    first = mount_cell(cells)
    reached = _breadth_first(neighbours, first, list(range(6)))
    if (reached == -2).any():
        lost = cells[np.flatnonzero(reached == -2)[0]].tolist()
        raise InputError(
            f"the model is not in one piece: voxel {lost} does not hang together with the rest "
            "through faces of voxels; join the pieces or print them one by one"
        )
    stuck: list[int] = []
    for parents in _trees(neighbours, first):
        assembly = _assembly(cells, neighbours, parents)
        order, left = _order(assembly, sizes)
        if not left:
            return _reordered(assembly, order)
        if not stuck or len(left) < len(stuck):
            stuck = left
    named = ", ".join(str(cells[i].tolist()) for i in stuck[:4])
    raise InputError(
        f"no way was found to put the model together by straight movements: {len(stuck)} voxels "
        f"block one another (such as {named}); open the model up there, or print it in two"
    )


def mount_cell(cells: Int[np.ndarray, "n 3"]) -> int:
    """The voxel of the lowest layer that is nearest to below the centre of mass."""
    level = cells[:, [0, 2]]
    away = ((level - level.mean(0)) ** 2).sum(1)
    return int(np.lexsort((level[:, 1], level[:, 0], away.round(9), cells[:, 1]))[0])


def cell_sides(
    cell: Int[np.ndarray, " 3"], sides: Int[np.ndarray, " 6"], sizes: PrintSizes
) -> Float[np.ndarray, "2 3 2"]:
    """(outer, cavity) bounds of a voxel's part, mm: [axis, low or high].

    Where another part lies flush, both are inset by half a clearance; the side towards the parent
    is open, so that the cavity goes as far as the part.
    """
    inset = np.where(sides == FLUSH, sizes.clearance_mm / 2, 0.0)
    wall = np.where(sides == OPEN, 0.0, sizes.wall_mm)
    lattice = sizes.face_mm * np.stack([cell, cell + 1], -1)
    return np.stack([shrunk(lattice, inset), shrunk(lattice, inset + wall)])


def shrunk(
    bounds: Float[np.ndarray, "3 2"], amounts: Float[np.ndarray, " 6"] | float
) -> Float[np.ndarray, "3 2"]:
    """Each side drawn inwards by an amount of its own."""
    high, low = np.broadcast_to(amounts, 6).reshape(3, 2).T
    return bounds + np.stack([low, -high], -1)


def collar_bounds(
    cavity: Float[np.ndarray, "3 2"], toward_parent: int, sizes: PrintSizes
) -> Float[np.ndarray, "3 2"]:
    """The collar that fills a cavity's open side up to a clearance per side, mm."""
    collar = shrunk(cavity, sizes.clearance_mm)
    axis, low = toward_parent // 2, toward_parent % 2 == 1
    start = cavity[axis, 0 if low else 1]
    collar[axis] = [start, start + sizes.collar_mm] if low else [start - sizes.collar_mm, start]
    return collar


def _neighbours(cells: np.ndarray) -> np.ndarray:
    """(n, 6) places of the neighbours, -1 where there is none."""
    place = {tuple(cell): i for i, cell in enumerate(cells.tolist())}
    return np.array([[place.get(tuple(c + n), -1) for n in NORMALS] for c in cells])


def _breadth_first(neighbours: np.ndarray, first: int, directions: list[int]) -> np.ndarray:
    """Parents: -1 for the first, -2 for what is not reached."""
    parents = np.full(len(neighbours), -2)
    parents[first] = -1
    queue = deque([first])
    while queue:
        here = queue.popleft()
        for side in directions:
            there = neighbours[here, side]
            if there >= 0 and parents[there] == -2:
                parents[there] = here
                queue.append(there)
    return parents


def _trees(neighbours: np.ndarray, first: int) -> Iterator[np.ndarray]:
    for directions in ([2, 3, 0, 1, 4, 5], [0, 1, 4, 5, 2, 3], [0, 1, 2, 3, 4, 5]):
        yield _breadth_first(neighbours, first, directions)
    generator = np.random.default_rng(0)
    for _ in range(_RANDOM_TREES):
        parents = np.full(len(neighbours), -2)
        parents[first] = -1
        # Prim's algorithm with random weights
        border = [(first, side) for side in range(6)]
        while border:
            here, side = border.pop(int(generator.integers(len(border))))
            there = neighbours[here, side]
            if there >= 0 and parents[there] == -2:
                parents[there] = here
                border += [(there, s) for s in range(6)]
        yield parents


def _assembly(cells: np.ndarray, neighbours: np.ndarray, parents: np.ndarray) -> PressFit:
    sides = np.where(neighbours >= 0, FLUSH, EXPOSED)
    toward = np.full(len(cells), DOWN)
    for part, parent in enumerate(parents.tolist()):
        if parent >= 0:
            side = int(np.flatnonzero(neighbours[part] == parent)[0])
            toward[part] = side
            sides[parent, opposite(side)] = COLLAR
        sides[part, toward[part]] = OPEN
    return PressFit(cells=cells, parents=parents, toward_parent=toward, sides=sides)


def _reordered(assembly: PressFit, order: list[int]) -> PressFit:
    place = np.argsort(order)
    old = assembly.parents[order]
    return PressFit(
        cells=assembly.cells[order],
        parents=np.where(old >= 0, place[old], -1),
        toward_parent=assembly.toward_parent[order],
        sides=assembly.sides[order],
    )


def _order(assembly: PressFit, sizes: PrintSizes) -> tuple[list[int], list[int]]:
    """(order of insertion, parts that cannot be taken off)."""
    pieces = [_pieces(assembly, part, sizes) for part in range(len(assembly))]
    pieces.append(_foot_pieces(assembly, sizes))
    owner = np.repeat(np.arange(len(pieces)), [len(p) for p in pieces])
    every = np.concatenate(pieces)
    present = np.ones(len(every), bool)
    holds = np.bincount(assembly.parents[assembly.parents >= 0], minlength=len(assembly))
    left, taken = list(range(len(assembly))), []
    while True:
        before = len(taken)
        for part in left[::-1]:
            if holds[part]:
                continue
            outward = opposite(int(assembly.toward_parent[part]))
            others = every[present & (owner != part)]
            if _meets(_swept(pieces[part], outward), others):
                continue
            taken.append(part)
            left.remove(part)
            present[owner == part] = False
            if assembly.parents[part] >= 0:
                holds[assembly.parents[part]] -= 1
        if len(taken) == before:
            return taken[::-1], left


def _pieces(assembly: PressFit, part: int, sizes: PrintSizes) -> np.ndarray:
    """(m, 3, 2) boxes that hold a part: its walls, without their windows, and its collars."""
    sides = assembly.sides[part]
    outer, cavity = cell_sides(assembly.cells[part], sides, sizes)
    boxes = []
    for side in range(6):
        if sides[side] != OPEN:
            axis, high = side // 2, side % 2 == 0
            wall = outer.copy()
            wall[axis, 0 if high else 1] = cavity[axis, 1 if high else 0]
            boxes.append(wall)
    boxes += [_collar_of(assembly, child, sizes) for child in assembly.children(part)]
    return np.stack(boxes)


def _foot_pieces(assembly: PressFit, sizes: PrintSizes) -> np.ndarray:
    return _collar_of(assembly, assembly.children(-1)[0], sizes)[None]


def _collar_of(assembly: PressFit, child: int, sizes: PrintSizes) -> np.ndarray:
    _, cavity = cell_sides(assembly.cells[child], assembly.sides[child], sizes)
    return collar_bounds(cavity, int(assembly.toward_parent[child]), sizes)


def _swept(boxes: np.ndarray, side: int) -> np.ndarray:
    swept = boxes.copy()
    high = side % 2 == 0
    swept[:, side // 2, 1 if high else 0] = np.inf if high else -np.inf
    return swept


def _meets(boxes: np.ndarray, others: np.ndarray) -> bool:
    """Whether any two share a volume; axis by axis, most pairs are far apart on the first."""
    apart = np.zeros((len(boxes), len(others)), bool)
    for axis in range(3):
        low = np.maximum(boxes[:, None, axis, 0], others[None, :, axis, 0])
        high = np.minimum(boxes[:, None, axis, 1], others[None, :, axis, 1])
        apart |= high - low <= _TOUCH_MM
    return bool((~apart).any())
