"""Transfer coefficients: a scene's radiance under unit light of each cell (thesis, 4.4.3).

Under a light that is constant in each cell of a probe, with values L_i, a point x of a Lambertian
scene has the radiance ``L(x) = sum_i L_i t_i(x)``, where ``t_i = t_i^d + t_i^1 + ...`` (Eq. 4.16)::

    t_i^d(x) = rho(x) / pi  int_cell V(x, w) <n, w>+ dw                          (Eq. 4.9)
    t_i^k(x) = rho(x) / pi  int (1 - V(x, w)) t_i^(k-1)(y(x, w)) <n, w>+ dw      (Eq. 4.13, 4.15)
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.relight.gather import MOST_RAYS, Gatherer, Nodes, gather_all
from skylight.probes.partitions.relight.receivers import Receivers
from skylight.probes.partitions.relight.scene import Scene
from skylight.work.forked import in_processes, shared_array
from skylight.work.progress import Progress


@dataclass(frozen=True, kw_only=True)
class TransferSampling:
    """Rays per point, number of bounces, and the seed of the rays.

    Standard error under uniform light of 1, of a dragon's and its ground's points, albedo 1:
    0.013 with 128 rays, 0.0076 with 256, 0.0046 with 512, 0.0027 with 1024; of one of 14
    coefficients, whose mean is 0.04: 0.0037, 0.0022, 0.0013, 0.0008.
    """

    rays: int = 512
    bounces: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.rays <= MOST_RAYS:
            raise InputError(f"rays must be 1 to {MOST_RAYS}, got {self.rays}")
        if self.bounces < 0:
            raise InputError(f"bounces must be 0 or more, got {self.bounces}")


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferCoefficients:
    """t_i (m,n,3) of m receivers and n cells, float32, albedo and all bounces included.

    ``orders`` (bounces + 1,) is the mean over receivers and colours of ``sum_i t_i^k``: what
    each number of bounces adds under uniform light of 1.
    """

    values: Float[Tensor, "m n 3"]
    orders: Float[Tensor, " k"]

    def __post_init__(self) -> None:
        if not bool(self.values.isfinite().all()):
            raise InputError("transfer coefficients have values that are NaN or infinite")

    def __len__(self) -> int:
        return len(self.values)


def transfer_coefficients(
    scene: Scene,
    cells: Cells,
    receivers: Receivers | None = None,
    *,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TransferCoefficients:
    """t_i at the scene's vertices, or at other points of it or near it.

    Light bounces between the vertices and is interpolated in between: floors on which shadows
    fall need small triangles (:func:`skylight.probes.partitions.relight.refine.refined`). Open
    parts are lit on both sides.

    workers
        processes, this one included; more than one needs ``fork`` (not on Windows). The result is
        the same to the byte.
    progress
        called with the share that is done, in [0, 1].

    Memory: 24 bytes for each blocked ray of a vertex (0.5 GB for 100,000 vertices, 512 rays and
    40 % blocked), 64 n bytes for each vertex, and 24 n for each other receiver.
    """
    sampling = sampling or TransferSampling()
    tell = progress or (lambda _share: None)
    if receivers is None:
        light = _NodeLight.of(scene, cells, sampling, sampling.bounces, workers, tell)
        vertices = len(scene.vertices)
        return TransferCoefficients(
            values=torch.from_numpy(light.total[:vertices]).reshape(vertices, cells.count, 3),
            orders=torch.from_numpy(light.sums[:, :vertices].mean((1, 2), dtype=np.float64)),
        )
    if sampling.bounces == 0:
        return _received(receivers, scene, cells, None, sampling, workers, tell)
    first = len(scene.vertices) / (len(scene.vertices) + len(receivers))
    light = _NodeLight.of(
        scene, cells, sampling, sampling.bounces - 1, workers, lambda share: tell(first * share)
    )
    return _received(
        receivers, scene, cells, light, sampling, workers,
        lambda share: tell(first + (1 - first) * share),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class _NodeLight:
    """t at the nodes, (k, 3 n) float32; its sums over the cells, order by order, (b, k, 3)."""

    nodes: Nodes
    total: Float[np.ndarray, "k c"]
    sums: Float[np.ndarray, "b k 3"]

    @staticmethod
    def of(
        scene: Scene,
        cells: Cells,
        sampling: TransferSampling,
        bounces: int,
        workers: int,
        progress: Progress,
    ) -> "_NodeLight":
        nodes = Nodes.of(scene)
        generator = torch.Generator().manual_seed(sampling.seed)
        gatherer = Gatherer(
            nodes.receivers, scene, nodes, cells, rays=sampling.rays, generator=generator
        )
        gathered = gather_all(gatherer, workers=workers, progress=progress)
        albedo = nodes.receivers.albedo.float().numpy()[:, None]
        order = albedo * gathered.direct[:, :, None]
        total, sums = order.copy(), [order.sum(1)]
        for _ in range(bounces):
            arriving = gathered.from_nodes(order.reshape(len(nodes), -1))
            order = albedo * arriving.reshape(order.shape)
            total += order
            sums.append(order.sum(1))
        return _NodeLight(nodes=nodes, total=total.reshape(len(nodes), -1), sums=np.stack(sums))


def _received(
    receivers: Receivers,
    scene: Scene,
    cells: Cells,
    light: _NodeLight | None,
    sampling: TransferSampling,
    workers: int,
    progress: Progress,
) -> TransferCoefficients:
    """What falls on other points than nodes, and that once the nodes' light is known."""
    # other random numbers than those of the nodes
    generator = torch.Generator().manual_seed(sampling.seed + (1 << 32))
    nodes = Nodes.of(scene) if light is None else light.nodes
    gatherer = Gatherer(receivers, scene, nodes, cells, rays=sampling.rays, generator=generator)
    albedo = receivers.albedo.float().numpy()[:, None]
    values = shared_array((len(receivers), cells.count, 3), np.float32)
    orders = shared_array((len(gatherer), sampling.bounces + 1), np.float64)

    def receive(i: int) -> None:
        block, rows = gatherer.cast(i), gatherer.rows(i)
        direct = albedo[rows] * block.direct.float().numpy()[:, :, None]
        values[rows] = direct
        orders[i, 0] = direct.sum()
        if light is not None:
            arriving = block.indirect @ light.total
            values[rows] += albedo[rows] * arriving.reshape(direct.shape)
            for k, sums in enumerate(light.sums, 1):
                orders[i, k] = (albedo[rows, 0] * (block.indirect @ sums)).sum()

    in_processes(receive, len(gatherer), workers=workers, progress=progress)
    return TransferCoefficients(
        values=torch.from_numpy(values),
        orders=torch.from_numpy(orders.sum(0) / (3 * max(1, len(receivers)))),
    )
