"""Transfer coefficients on disk: .npz, float16, with a key of all that they depend on."""

import hashlib
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from skylight.errors import InputError
from skylight.io.atomic import atomic_path
from skylight.io.bounded import load_arrays
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.relight.receivers import Receivers
from skylight.probes.partitions.relight.scene import Scene
from skylight.probes.partitions.relight.transfer import (
    TransferCoefficients,
    TransferSampling,
    transfer_coefficients,
)
from skylight.probes.partitions.relight.turning import (
    Turn,
    TurningCoefficients,
    turning_coefficients,
)
from skylight.work.progress import Progress

_VERSION = 1  # one more whenever the numbers change that the same scene gives
_NAMES = ("version", "key", "values", "orders")
Coefficients = TypeVar("Coefficients", TransferCoefficients, TurningCoefficients)


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
    design = {"seeds": cells.design.seeds, "labels": cells.design.labels}
    for part in (scene, receivers):
        if part is None:
            digest.update(b"none")
            continue
        # a frozen dataclass keeps what it has worked out beside its fields
        fields = {name: getattr(part, name) for name in part.__dataclass_fields__}
        _add(digest, fields)
    _add(digest, design)
    if turn is not None:
        digest.update(str(turn).encode())
    return digest.hexdigest()


def _add(digest: "hashlib._Hash", tensors: Mapping[str, Tensor | None]) -> None:
    for name, tensor in tensors.items():
        if tensor is not None:
            digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
            digest.update(np.ascontiguousarray(tensor.numpy()).tobytes())


def save_transfer(
    path: str | Path, coefficients: TransferCoefficients | TurningCoefficients, key: str
) -> None:
    """As float16: 6 n bytes for each receiver and angle, to 0.05 % or 3e-8, whichever is more.

    ``values`` of the file are (m,n,3), or (K,m,n,3) of a turning scene.
    """
    values = coefficients.values
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


def load_transfer(path: str | Path, key: str | None = None) -> TransferCoefficients:
    """What :func:`save_transfer` wrote of a scene that stands still.

    Raises
    ------
    InputError
        No such file, a damaged one, or one of another ``key``.
    """
    values, orders = _read(path, key, 3)
    return TransferCoefficients(values=values, orders=orders)


def load_turning_transfer(path: str | Path, key: str | None = None) -> TurningCoefficients:
    """As :func:`load_transfer`, of a scene that turns."""
    values, orders = _read(path, key, 4)
    return TurningCoefficients(values=values, orders=orders)


def _read(path: str | Path, key: str | None, dimensions: int) -> tuple[Tensor, Tensor]:
    """(values, orders)."""
    try:
        content = load_arrays(Path(path), _NAMES)
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
    if values.dtype != np.float16 or values.ndim != dimensions or values.shape[-1] != 3:
        raise InputError(f"{path}: the transfer coefficients have a wrong shape")
    if orders.dtype != np.float64 or orders.ndim != 1:
        raise InputError(f"{path}: the sums of the bounces have a wrong shape")
    return torch.from_numpy(values.astype(np.float32)), torch.from_numpy(orders)


def kept_transfer(
    path: str | Path,
    scene: Scene,
    cells: Cells,
    receivers: Receivers | None = None,
    *,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TransferCoefficients:
    """:func:`transfer_coefficients`, cached in the file ``path``.

    Coefficients of another scene, probe, sampling or version are replaced.

    Raises
    ------
    InputError
        The file holds something else, or is damaged; it stays as it is.
    """
    key = transfer_key(scene, cells, receivers, sampling=sampling)

    def make() -> TransferCoefficients:
        return transfer_coefficients(
            scene, cells, receivers, sampling=sampling, workers=workers, progress=progress
        )

    return _kept(path, key, make, load_transfer)


def kept_turning_transfer(
    path: str | Path,
    scene: Scene,
    cells: Cells,
    turn: Turn,
    *,
    sampling: TransferSampling | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> TurningCoefficients:
    """:func:`turning_coefficients`, cached as :func:`kept_transfer` does."""
    key = transfer_key(scene, cells, sampling=sampling, turn=turn)

    def make() -> TurningCoefficients:
        return turning_coefficients(
            scene, cells, turn, sampling=sampling, workers=workers, progress=progress
        )

    return _kept(path, key, make, load_turning_transfer)


def _kept(
    path: str | Path,
    key: str,
    make: Callable[[], Coefficients],
    load: Callable[[str | Path, str], Coefficients],
) -> Coefficients:
    if Path(path).exists():
        _require_ours(path)
        try:
            return load(path, key)
        except InputError:
            pass  # stale
    save_transfer(path, make(), key)
    return load(path, key)  # the same numbers the first time and later


def _require_ours(path: str | Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            ours = set(archive.namelist()) == {f"{name}.npy" for name in _NAMES}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        ours = False
    if not ours:
        raise InputError(
            f"{path}: holds no transfer coefficients, or is damaged: delete it, or name another"
        )
