"""Transfer coefficients: a scene's radiance under unit light of each cell (thesis, 4.4.3).

Under a light that is constant in each cell of a probe, with values L_i, a point x of a Lambertian
scene has the radiance ``L(x) = sum_i L_i t_i(x)``, where ``t_i = t_i^d + t_i^1 + ...`` (Eq. 4.16)::

    t_i^d(x) = rho(x) / pi  int_cell V(x, w) <n, w>+ dw                          (Eq. 4.9)
    t_i^k(x) = rho(x) / pi  int (1 - V(x, w)) t_i^(k-1)(y(x, w)) <n, w>+ dw      (Eq. 4.13, 4.15)

On disk they are .npz in float16, with a key of all that they depend on.

Scenes can turn about an axis (open in the thesis, section 4.6): a scene that is turned by a under
cells that stand still is, in its own frame, one that stands still under cells that are turned by
-a. So the coefficients at K angles are those of one scene under K sets of cells, from the same
rays, whose noise keeps its place on the scene and changes smoothly with the angle. A ground that
takes the scene's shadow turns along: what it has of contact shadow is the same at all angles, and
only where the light comes from is interpolated.
"""

import hashlib
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import load_arrays
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions.relight._atlas import Receivers
from skylight.probes.partitions.relight._gather import MOST_RAYS, Gatherer, Nodes, gather_all
from skylight.probes.partitions.relight._scene import Scene
from skylight.sphere._rotation import RigidTransform
from skylight.work._processes import in_processes, shared_array
from skylight.work._progress import Progress


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

    Of a scene that turns they are (K,m,n,3), those of each of K angles, and the receivers are
    points of the turning frame. ``orders`` (bounces + 1,) is the mean over receivers, colours and
    angles of ``sum_i t_i^k``: what each number of bounces adds under uniform light of 1.
    """

    values: Float[Tensor, "*k m n 3"]
    orders: Float[Tensor, " b"]

    def __len__(self) -> int:
        return self.values.shape[-3]


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
    fall need small triangles (:func:`skylight.probes.partitions.relight._atlas.refined`). Open
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


_FEWEST, _MOST = 4, 360


@dataclass(frozen=True, kw_only=True)
class Turn:
    """K ``angles`` a_k = 2 pi k / K about an ``axis`` of any length, by the right hand."""

    angles: int = 24
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if not _FEWEST <= self.angles <= _MOST:
            raise InputError(f"a turn has {_FEWEST} to {_MOST} angles, got {self.angles}")

    @property
    def angles_rad(self) -> list[float]:
        return [2 * math.pi * k / self.angles for k in range(self.angles)]

    def rotation(self, angle_rad: float) -> RigidTransform:
        """About the axis through the origin."""
        axis = normalize(torch.tensor(self.axis, dtype=torch.float64), dim=0)
        return RigidTransform.from_vector(torch.cat([angle_rad * axis, torch.zeros(3).double()]))


def turning_coefficients(
    scene: Scene,
    cells: Cells,
    turn: Turn,
    *,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TransferCoefficients:
    """t_i at the vertices of a scene, as it stands at a = 0, turned by each of K angles.

    K times the work of :func:`transfer_coefficients`, and 12 K n bytes for each vertex: 4 KB with
    24 angles and 14 cells.
    """
    tell = progress or (lambda _share: None)
    values = torch.empty(turn.angles, len(scene.vertices), cells.count, 3)
    orders = []
    for k, angle_rad in enumerate(turn.angles_rad):
        back = turn.rotation(-angle_rad).rotation
        made = transfer_coefficients(
            scene,
            Cells.of(cells.design.rotated(back)) if k else cells,
            sampling=sampling,
            workers=workers,
            progress=lambda share, k=k: tell((k + share) / turn.angles),
        )
        values[k] = made.values
        orders.append(made.orders)
    return TransferCoefficients(values=values, orders=torch.stack(orders).mean(0))


_VERSION = 1  # one more whenever the numbers change that the same scene gives
_NAMES = ("version", "key", "values", "orders")


def transfer_key(
    scene: Scene,
    cells: Cells,
    receivers: Receivers | None = None,
    *,
    sampling: TransferSampling | None = None,
    turn: Turn | None = None,
) -> str:
    """SHA-256 of scene, cells, receivers, sampling and turn; equal keys, equal numbers.

    A design's name and the names of files are no part of it.
    """
    digest = hashlib.sha256(f"{_VERSION} {sampling or TransferSampling()}".encode())

    def add(tensors: Mapping[str, Tensor | None]) -> None:
        for name, tensor in tensors.items():
            if tensor is not None:
                digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
                digest.update(np.ascontiguousarray(tensor.numpy()).tobytes())

    for part in (scene, receivers):
        if part is None:
            digest.update(b"none")
        else:
            # a frozen dataclass keeps what it has worked out beside its fields
            add({name: getattr(part, name) for name in part.__dataclass_fields__})
    add({"seeds": cells.design.seeds, "labels": cells.design.labels})
    if turn is not None:
        digest.update(str(turn).encode())
    return digest.hexdigest()


def save_transfer(path: Path, coefficients: TransferCoefficients, key: str) -> None:
    """As float16: 6 n bytes for each receiver and angle, to 0.05 % or 3e-8, whichever is more."""
    values = coefficients.values
    if not bool(values.isfinite().all()):
        raise InputError("transfer coefficients have values that are NaN or infinite")
    largest = float(values.abs().amax()) if values.numel() else 0.0
    if largest > torch.finfo(torch.float16).max:
        raise InputError(f"coefficients of {largest:g} do not fit: albedos must be below 1")
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(
            stream,
            version=np.array(_VERSION),
            key=np.array(key),
            values=values.numpy().astype(np.float16),
            orders=coefficients.orders.numpy().astype(np.float64),
        )


def load_transfer(path: Path, key: str | None = None) -> TransferCoefficients:
    """What :func:`save_transfer` wrote; refuses another ``key``."""
    try:
        content = load_arrays(path, _NAMES)
        version, found = int(content["version"]), str(content["key"])
        values, orders = content["values"], content["orders"]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as transfer coefficients ({error})") from error
    if version != _VERSION:
        raise InputError(
            f"{path}: transfer coefficients of version {version}, this program reads {_VERSION}; "
            "make them again"
        )
    if key is not None and found != key:
        raise InputError(
            f"{path}: made for another scene, probe or sampling than these; make them again"
        )
    if values.dtype != np.float16 or values.ndim not in (3, 4) or values.shape[-1] != 3:
        raise InputError(f"{path}: the transfer coefficients have a wrong shape")
    if orders.dtype != np.float64 or orders.ndim != 1:
        raise InputError(f"{path}: the sums of the bounces have a wrong shape")
    if not np.isfinite(values).all():
        raise InputError(f"{path}: transfer coefficients have values that are NaN or infinite")
    return TransferCoefficients(
        values=torch.from_numpy(values.astype(np.float32)), orders=torch.from_numpy(orders)
    )


def kept_transfer(
    path: Path,
    scene: Scene,
    cells: Cells,
    receivers: Receivers | None = None,
    *,
    turn: Turn | None = None,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TransferCoefficients:
    """:func:`transfer_coefficients`, or those of the vertices at each angle of a ``turn``, cached.

    Coefficients of another scene, probe, sampling or version in the file ``path`` are replaced; a
    file that is damaged or holds something else is refused, and stays as it is.
    """
    key = transfer_key(scene, cells, receivers, sampling=sampling, turn=turn)
    if path.exists():
        _require_ours(path)
        try:
            return load_transfer(path, key)
        except InputError:
            pass  # stale
    if turn is None:
        made = transfer_coefficients(
            scene, cells, receivers, sampling=sampling, workers=workers, progress=progress
        )
    else:
        made = turning_coefficients(
            scene, cells, turn, sampling=sampling, workers=workers, progress=progress
        )
    save_transfer(path, made, key)
    return load_transfer(path, key)  # the same numbers the first time and later


def _require_ours(path: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            ours = set(archive.namelist()) == {f"{name}.npy" for name in _NAMES}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        ours = False
    if not ours:
        raise InputError(
            f"{path}: holds no transfer coefficients, or is damaged: delete it, or name another"
        )
