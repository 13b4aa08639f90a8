"""MakeHuman's mesh and targets, read from the packages that publish them."""

import io
import json
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

DECIMETRE = 0.1  # MakeHuman's unit, in metres
# MakeHuman's average head is small for adults: eye centres 58 mm apart, outer eye corners 84, head
# breadth 142, nasion to chin 110, where surveys of men and women (Farkas 1994; Gordon et al. 2014)
# average about 62, 88, 149 and 117.
ADULT_SCALE = 1.06


@dataclass(frozen=True)
class Assets:
    """MakeHuman's full figure: ``vertices`` (n, 3) dm, ``quads`` by group name, and the targets."""

    vertices: np.ndarray
    groups: dict[str, np.ndarray]
    targets: dict[str, np.ndarray]

    def names(self, folder: str) -> list[str]:
        """Names of the targets directly inside ``targets/<folder>``."""
        head = f"targets/{folder}/"
        found = (key[: -len(".index")] for key in self.targets if key.endswith(".index"))
        return sorted(n for n in found if n.startswith(head) and "/" not in n[len(head) :])

    def offsets(self, name: str) -> np.ndarray:
        """Target ``name`` as dense offsets (n, 3) in dm."""
        dense = np.zeros_like(self.vertices)
        index = self.targets[f"{name}.index"].astype(np.int64)
        dense[index] = self.targets[f"{name}.vector"] * 1e-3
        return dense


def read_assets(targets: Path, mesh: Path) -> Assets:
    """Read both packages, packed or unpacked."""
    if targets.suffix == ".whl":
        with zipfile.ZipFile(targets) as wheel:
            packed = io.BytesIO(wheel.read("makehuman/data/targets.npz"))
    else:
        packed = io.BytesIO(targets.read_bytes())
    with np.load(packed) as archive:
        # The archive's own licence note is an object array, which a safe load refuses; skip it.
        table = {key: archive[key] for key in archive.files if not key.endswith(".license")}

    if mesh.suffix == ".json":
        text = mesh.read_text()
    else:
        with tarfile.open(mesh) as tar:
            member = tar.extractfile("package/public/data/models/human_full_size.json")
            if member is None:
                raise SystemExit(f"{mesh}: no human_full_size.json inside")
            text = member.read().decode()
    model = json.loads(text)
    vertices = np.asarray(model["vertices"], dtype=np.float64).reshape(-1, 3)
    # Face record (type 11: quad, material, vertex uvs): type, 4 vertices, material, 4 uvs.
    records = np.asarray(model["faces"], dtype=np.int64).reshape(-1, 10)
    if not (records[:, 0] == 11).all():
        raise SystemExit(f"{mesh}: expected quads with a material and uvs only")
    names = [material["DbgName"] for material in model["materials"]]
    groups = {name: records[records[:, 5] == i, 1:5] for i, name in enumerate(names)}
    return Assets(vertices, groups, table)
