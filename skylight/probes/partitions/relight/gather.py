"""Gathering at points of a scene: unoccluded light of each cell, and light of the scene itself.

N rays leave each point x, directions following the cosine. The rays of a cell i are a sample of
the cell, of the known share ``e_i = 1 / pi int_cell <n, w>+ dw`` of what the point gathers, so a
ray of the cell stands for ``e_i / N_i`` (post-stratification; Cochran, Sampling
Techniques, 5A.9)::

    1 / pi int_cell V <n, w>+ dw       ~  e_i free_i / N_i
    1 / pi int (1 - V) L(y) <n, w>+ dw ~  sum over blocked rays of  e_i / N_i  L(y(x, ray))

Points that see all or nothing of a cell are exact, nothing is negative, and the weights of all
rays add up to 1, so that a white furnace stays white. Of a cell that is seen in part, the bias is
below 2 % of the cell at 16 rays and 1 % at 64, since the numbers N_i depend on where the rays went.
Cells without a ray, which are small, get the mean visibility of the point.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from torch import Tensor
from torch.quasirandom import SobolEngine

from skylight.errors import InputError
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.relight.receivers import Receivers
from skylight.probes.partitions.relight.scene import Scene
from skylight.transport.indirect.path_tracer import cosine_directions
from skylight.work.forked import in_processes, shared_array
from skylight.work.progress import Progress

MOST_RAYS = 1 << 16
_RAYS_AT_ONCE = 1 << 17  # their numbers stay in the processor's caches


@dataclass(frozen=True, kw_only=True, eq=False)
class Nodes:
    """Where the scene's own light is known: its vertices' fronts, and backs of two-sided parts.

    Other backs are never lit or never seen. ``back`` (v,) numbers the vertices' backs; -1: none.
    """

    receivers: Receivers
    back: Int[Tensor, " v"]

    @staticmethod
    def of(scene: Scene) -> "Nodes":
        front = Receivers.at_vertices(scene)
        two_sided = scene.faces[scene.two_sided].unique()
        back = torch.full((len(front),), -1)
        back[two_sided] = len(front) + torch.arange(len(two_sided))
        return Nodes(receivers=Receivers.joined(front, front.behind(two_sided)), back=back)

    def __len__(self) -> int:
        return len(self.receivers)


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """What some receivers gather: ``direct`` (b,n) from cells, ``indirect`` (b,k) from nodes.

    Rows of both add up to 1, less what falls on backs that are never lit.
    """

    direct: Float[Tensor, "b n"]
    indirect: csr_array


class Gatherer:
    """Casts the rays of ``receivers``, some at a time; the same whoever casts which block."""

    def __init__(
        self,
        receivers: Receivers,
        scene: Scene,
        nodes: Nodes,
        cells: Cells,
        *,
        rays: int,
        generator: torch.Generator,
    ) -> None:
        if not 1 <= rays <= MOST_RAYS:
            raise InputError(f"rays must be 1 to {MOST_RAYS}, got {rays}")
        self.receivers, self.rays = receivers, rays
        self._scene, self.nodes, self.cells = scene, nodes, cells
        seed = int(torch.randint(1 << 31, (1,), generator=generator))
        self._sequence = SobolEngine(2, scramble=True, seed=seed).draw(rays)
        # Cranley and Patterson 1976: neighbours' errors are independent
        self._shifts = torch.rand(len(receivers), 1, 2, generator=generator)
        self._at_once = max(1, _RAYS_AT_ONCE // rays)
        # before anyone forks
        self._raycaster, self._face_normals = scene.raycaster, scene.face_normals.float()
        self._two_sided = scene.two_sided

    def __len__(self) -> int:
        """How many blocks there are."""
        return -(-len(self.receivers) // self._at_once)

    def rows(self, block: int) -> slice:
        """Which receivers a block holds."""
        start = block * self._at_once
        return slice(start, min(start + self._at_once, len(self.receivers)))

    def cast(self, block: int) -> Block:
        rows = self.rows(block)
        normals = self.receivers.normals[rows]
        lifted = self._raycaster.epsilon * self.receivers.geometric_normals[rows].double()
        starts = (self.receivers.positions[rows].double() + lifted).float()
        count = len(normals)
        owner = torch.arange(count).repeat_interleave(self.rays)
        uniform = ((self._sequence + self._shifts[rows]) % 1).reshape(-1, 2)
        directions, _ = cosine_directions(normals.float()[owner], uniform)
        hits = self._raycaster.intersect(starts[owner], directions)

        slot = owner * self.cells.count + self.cells.cell_of(directions)
        free, slots = hits.face < 0, count * self.cells.count
        in_cell = torch.bincount(slot, minlength=slots).reshape(count, -1)
        free_in_cell = torch.bincount(slot[free], minlength=slots).reshape(count, -1)
        share = self.cells.clamped_cosine(normals.double()) / math.pi
        met = in_cell > 0
        each = torch.where(met, share / in_cell.clamp(min=1), 0)
        unmet = torch.where(met, 0, share)
        direct = each * free_in_cell + unmet * (free_in_cell.sum(1, keepdim=True) / self.rays)
        weight = each.flatten()[slot] + (unmet.sum(1) / self.rays)[owner]

        back = (self._face_normals[hits.face] * directions).sum(1) > 0
        kept = torch.nonzero(~free & ~(back & ~self._two_sided[hits.face]))[:, 0]
        corners = self._scene.faces[hits.face[kept]]
        node = torch.where(back[kept, None], self.nodes.back[corners], corners)
        values = hits.barycentric[kept] * weight[kept, None]
        ends = torch.bincount(owner[kept], minlength=count).cumsum(0)
        pointers = torch.nn.functional.pad(3 * ends, (1, 0))
        indirect = csr_array(
            (
                values.float().flatten().numpy(),
                node.int().flatten().numpy(),
                pointers.int().numpy(),
            ),
            shape=(count, len(self.nodes)),
        )
        return Block(direct=direct, indirect=indirect)


@dataclass(frozen=True, kw_only=True, eq=False)
class Gathered:
    """All blocks of a gatherer; ``gatherer.rows(i)`` says whose ``indirect[i]`` is."""

    direct: Float[np.ndarray, "m n"]
    indirect: list[csr_array]

    def from_nodes(self, light: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "m c"]:
        """What the nodes' light brings to the receivers, albedo 1."""
        return np.concatenate([block @ light for block in self.indirect])


def gather_all(
    gatherer: Gatherer, *, workers: int = 1, progress: Progress | None = None
) -> Gathered:
    """Every block, kept: 24 bytes for each blocked ray, in memory shared by the processes."""
    most = 3 * gatherer.rays
    count = len(gatherer.receivers)
    direct = shared_array((count, gatherer.cells.count), np.float32)
    pointers = shared_array((len(gatherer), gatherer.rows(0).stop + 1), np.int32)
    # room for all rays to be blocked; what is not written takes no memory
    nodes = shared_array((count * most,), np.int32)
    weights = shared_array((count * most,), np.float32)

    def cast(i: int) -> None:
        block, rows = gatherer.cast(i), gatherer.rows(i)
        direct[rows] = block.direct.numpy()
        pointers[i, : rows.stop - rows.start + 1] = block.indirect.indptr
        here = slice(rows.start * most, rows.start * most + block.indirect.nnz)
        nodes[here], weights[here] = block.indirect.indices, block.indirect.data

    in_processes(cast, len(gatherer), workers=workers, progress=progress)

    def kept(i: int) -> csr_array:
        rows = gatherer.rows(i)
        pointer = pointers[i, : rows.stop - rows.start + 1]
        here = slice(rows.start * most, rows.start * most + int(pointer[-1]))
        return csr_array(
            (weights[here], nodes[here], pointer),
            shape=(rows.stop - rows.start, len(gatherer.nodes)),
        )

    return Gathered(direct=direct, indirect=[kept(i) for i in range(len(gatherer))])
