"""MagicaVoxel's .vox; what begins like one of numpy's grids is read as .npy."""

import struct

import numpy as np

from skylight.probes.voxel._model import read_voxels, star_probe, write_voxels
from tests.fuzz.files import as_file, written


def seeds() -> list[bytes]:
    cells = np.argwhere(star_probe(3).occupied)
    size = b"SIZE" + struct.pack("<iiiii", 12, 0, 3, 3, 3)
    listed = b"".join(struct.pack("<4B", *cell, 1) for cell in cells)
    voxels = b"XYZI" + struct.pack("<iii", 4 + len(listed), 0, len(cells)) + listed
    children = size + voxels
    vox = (
        b"VOX " + struct.pack("<i", 150) + b"MAIN" + struct.pack("<ii", 0, len(children)) + children
    )
    return [vox, written("a.npy", lambda path: write_voxels(path, star_probe(3)))]


def read(content: bytes) -> None:
    name = "model.npy" if content[:1] == b"\x93" else "model.vox"
    model = read_voxels(as_file(content, name))
    assert model.occupied.any()
