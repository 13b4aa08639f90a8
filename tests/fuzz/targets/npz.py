""".npz: lightmaps, transfer coefficients, precomputed scenes; all readers on each content.

What does not begin like a ZIP file is packed into one, member by member, or checksums would keep
everything from numpy's reader.
"""

import io
import zipfile

import numpy as np
import torch

from skylight.probes.partitions.relight._transfer import (
    TransferCoefficients,
    load_transfer,
    save_transfer,
)
from skylight.probes.voxel._lightmap import Lightmap, load_lightmap
from skylight.relight._runtime import PrecomputedScene, load_scene, relight
from tests.fuzz.files import as_file, joined, parted, read_by_any, written


def seeds() -> list[bytes]:
    transfer = TransferCoefficients(values=torch.rand(4, 6, 3), orders=torch.rand(2).double())
    turning = TransferCoefficients(values=torch.rand(4, 2, 6, 3), orders=torch.rand(2).double())
    rows, columns = 2, 4
    scene = PrecomputedScene(
        layout=(6, 8),
        focal_px=8.0,
        center_px=(4.0, 3.0),
        pixels=np.array([[1, 1], [2, 5]], np.uint16),
        normals=np.array([[0, 1, 0], [0, 0, 1]], np.float32),
        albedo=np.full((2, 3), 0.5, np.float32),
        on_ground=np.array([True, False]),
        visible=np.full((2, 1), 255, np.uint8),
        grid_layout=(rows, columns),
        directions=np.eye(8, 3, dtype=np.float32),
        solid_angles=np.full(8, 1.5, np.float32),
    )
    whole = [
        written("a.npz", Lightmap.blank(2).save),
        written("b.npz", lambda path: save_transfer(path, transfer, "key")),
        written("c.npz", scene.save),
        written("d.npz", lambda path: save_transfer(path, turning, "key")),
    ]
    return [*whole, *(_unpacked(each) for each in whole)]


def read(content: bytes) -> None:
    path = as_file(content if content[:2] == b"PK" else _packed(content), "a.npz")
    readers = (
        lambda: load_lightmap(path),
        lambda: load_transfer(path),
        lambda: relight(load_scene(path), np.ones((4, 8, 3), np.float32)),
    )
    read_by_any(readers)


def _unpacked(content: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return joined({name: archive.read(name) for name in archive.namelist()})


def _packed(content: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in parted(content).items():
            if name:
                archive.writestr(name, data)
    return out.getvalue()
