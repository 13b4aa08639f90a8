"""Designs of partition probes: seed directions, and which of their regions form one cell.

A design file is JSON; seeds need not have unit length, and merged seeds are named by their place
in the list, from 0::

    {"kind": "partition probe design", "format": 1, "name": "cube", "oriented": false,
     "seeds": [[1, 0, 0], [-1, 0, 0], ...], "merges": [[0, 2], [1, 3, 4]]}
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.io._bounded import read_object, read_whole, require_keys, write_json

CLOSEST_SEEDS_RAD = 1e-3
# cos of how far a direction may at most be from its closest seed: 89.4 degrees
_LEAST_COVER = 0.01
_KIND = "partition probe design"
_FORMAT = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeDesign:
    """Seeds (s,3), float64, unit, in the probe's frame, and the cell (s,) each one belongs to.

    A cell is what lies closer to its seeds than to those of other cells (thesis, 4.3.1 and 4.5).
    Cells are numbered 0..n-1. An ``oriented`` design's axes are the world's (+Y up), as where the
    sun goes: such a probe must not be turned.
    """

    name: str
    seeds: Float[Tensor, "s 3"]
    labels: Int[Tensor, " s"]
    oriented: bool = False

    def __post_init__(self) -> None:
        if self.labels.shape != self.seeds.shape[:1]:
            raise InputError(f"{len(self.seeds)} seeds need as many labels, got {len(self.labels)}")
        _check_seeds(self.seeds)
        used = self.labels.unique()
        if not torch.equal(used, torch.arange(len(used), dtype=used.dtype)):
            raise InputError(f"cells must be numbered 0, 1, 2..., got {used.tolist()}")

    @staticmethod
    def of(
        name: str,
        seeds: Float[Tensor, "s 3"],
        merges: Sequence[Sequence[int]] = (),
        *,
        oriented: bool = False,
    ) -> "ProbeDesign":
        """From seeds of any length and lists of the seeds that share a cell.

        Cells are numbered by their first seeds.
        """
        seeds = torch.as_tensor(seeds, dtype=torch.float64)
        if not bool(seeds.isfinite().all()):
            raise InputError("seeds must be finite numbers")
        lengths = seeds.norm(dim=1, keepdim=True)
        if bool((lengths == 0).any()):
            raise InputError(f"seed {int(lengths[:, 0].argmin())} is zero: it has no direction")
        return ProbeDesign(
            name=name,
            seeds=seeds / lengths,
            labels=_labels(len(seeds), merges),
            oriented=oriented,
        )

    @property
    def count(self) -> int:
        """Number of cells n."""
        return int(self.labels.max()) + 1

    @property
    def merges(self) -> list[list[int]]:
        """Seeds of every cell that has more than one."""
        cells = [torch.nonzero(self.labels == i)[:, 0].tolist() for i in range(self.count)]
        return [cell for cell in cells if len(cell) > 1]

    def rotated(self, rotation: Float[Tensor, "3 3"]) -> "ProbeDesign":
        """The same cells, their directions rotated."""
        return replace(self, seeds=normalize(self.seeds @ rotation.T, dim=1))

    def to_json(self) -> dict[str, Any]:
        """What a design file holds."""
        return {
            "kind": _KIND,
            "format": _FORMAT,
            "name": self.name,
            "seeds": self.seeds.tolist(),
            "merges": self.merges,
            "oriented": self.oriented,
        }


def save_design(path: str | Path, design: ProbeDesign) -> None:
    """Write a design as the JSON that :func:`load_design` reads."""
    write_json(path, design.to_json())


def load_design(path: str | Path) -> ProbeDesign:
    """Read a design file; raises :class:`InputError` that names the file and what is wrong."""
    content = read_object(path, _KIND)
    require_keys(path, content, ["format", "name", "seeds"])
    try:
        return _design_of(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _design_of(content: dict[str, Any]) -> ProbeDesign:
    if read_whole(content, "format") != _FORMAT:
        raise InputError(f'"format" is {content["format"]}, this version reads {_FORMAT}')
    name, oriented = content["name"], content.get("oriented", False)
    if not isinstance(name, str) or not name.strip():
        raise InputError(f'"name" must be a text, got {name!r}')
    if not isinstance(oriented, bool):
        raise InputError(f'"oriented" must be true or false, got {oriented!r}')
    seeds, merges = content["seeds"], content.get("merges", [])
    if not _is_table(seeds, int | float) or not seeds or any(len(seed) != 3 for seed in seeds):
        raise InputError('"seeds" must be a list of directions [x, y, z]')
    if not _is_table(merges, int):
        raise InputError('"merges" must be a list of lists of whole numbers, the seeds of a cell')
    return ProbeDesign.of(name, torch.tensor(seeds, dtype=torch.float64), merges, oriented=oriented)


def _is_table(value: object, kind: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(row, list)
        and all(isinstance(entry, kind) and not isinstance(entry, bool) for entry in row)
        for row in value
    )


def _labels(count: int, merges: Sequence[Sequence[int]]) -> Int[Tensor, " s"]:
    first = list(range(count))
    seen: set[int] = set()
    for merge in merges:
        if len(merge) < 2:
            raise InputError(f"merge {list(merge)}: a merge needs two seeds or more")
        for seed in merge:
            if not 0 <= seed < count:
                raise InputError(f"merge {list(merge)} names seed {seed}; seeds are 0..{count - 1}")
            if seed in seen:
                raise InputError(f"seed {seed} is merged twice: name it once")
            seen.add(seed)
            first[seed] = min(merge)
    return torch.tensor(first).unique(return_inverse=True)[1]


def _check_seeds(seeds: Float[Tensor, "s 3"]) -> None:
    """Unit, distinct, and around the whole sphere, so that every region is less than its half.

    A direction w at least 90 degrees from seed i belongs to it only if it is as far from all
    others, so all regions stay in the open hemispheres of their seeds if and only if the seeds'
    convex hull holds the origin inside.
    """
    if seeds.dtype != torch.float64 or not bool(seeds.isfinite().all()):
        raise InputError("seeds must be finite numbers of double precision")
    if not bool(((seeds.norm(dim=1) - 1).abs() < 1e-9).all()):
        raise InputError("seeds must have unit length: make the design with ProbeDesign.of")
    if len(seeds) < 4:
        raise InputError(f"a probe needs 4 seeds or more, got {len(seeds)}")
    distance = torch.cdist(seeds, seeds, compute_mode="donot_use_mm_for_euclid_dist")
    close = torch.triu(distance < CLOSEST_SEEDS_RAD, diagonal=1).nonzero()
    if len(close):
        i, j = close[0].tolist()
        raise InputError(f"seeds {i} and {j} coincide: they must be 0.06 degrees apart or more")
    try:
        cover = -ConvexHull(seeds.numpy()).equations[:, 3].max()
    except QhullError as error:
        raise InputError(
            "all seeds lie on one circle, so that cells reach round the sphere: add others"
        ) from error
    if cover < _LEAST_COVER:
        raise InputError(
            "the seeds leave a hemisphere empty, so that cells reach beyond their face's "
            "horizon: add seeds there"
        )
