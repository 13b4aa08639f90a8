"""A printed partition probe over its marker board: its file, its solids, and its sizes.

Sizes that the user does not name follow from the design: the kernel is the smallest that can be
printed, since what a face sees of other cells grows with its distance from the centre over the
shell's radius, but with faces that a camera can read.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import read_object, require_keys
from skylight.probes.cameras._board import (
    Pole,
    ProbeAssembly,
    cylinder_mesh,
    read_placement,
    unoccluded,
)
from skylight.probes.fabrication._parts import merged
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions.printed._halves import (
    ProbeParts,
    ShellPlan,
    probe_parts,
    standing_rotation,
)
from skylight.probes.partitions.printed._solids import NOZZLE_MM, ProbeSizes, WallNet, face_radii
from skylight.sphere._rotation import RigidTransform
from skylight.transport._rays import Raycaster

_KIND, _FORMAT = "partition probe assembly", 1
_ORIENTED_MOST_DEG = 25.0  # as it may be found to stand, which is warned of


class PlacedPartitions:
    """The faces of a probe in the board's frame (mm), and everything that stands in their way.

    ``face_centres`` (n,3), ``normals`` (n,3), ``face_radii`` (n,): how far round its centre a face
    is free of walls; ``vertices`` (v,3) and ``triangles`` (f,3): shell, kernel and pole.
    """

    def __init__(
        self,
        face_centres: Float[np.ndarray, "n 3"],
        normals: Float[np.ndarray, "n 3"],
        face_radii: Float[np.ndarray, " n"],
        vertices: Float[np.ndarray, "v 3"],
        triangles: Int[np.ndarray, "f 3"],
    ) -> None:
        self.face_centres, self.normals, self.face_radii = face_centres, normals, face_radii
        self.vertices, self.triangles = vertices, triangles
        self.caster = Raycaster(torch.from_numpy(vertices), torch.from_numpy(triangles))

    def sees(
        self, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "*n 3"]
    ) -> Float[Tensor, "*n"]:
        """1 where nothing is between a point of a face and the eye, 0 elsewhere."""
        return unoccluded(self.caster, eye, points)

    def moved(self, motion: RigidTransform) -> "PlacedPartitions":
        """The same solids elsewhere on the board."""
        return PlacedPartitions(
            face_centres=motion.points(self.face_centres),
            normals=motion.directions(self.normals),
            face_radii=self.face_radii,
            vertices=motion.points(self.vertices),
            triangles=self.triangles,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class PartitionAssembly(ProbeAssembly):
    """What was printed, and where it stands: the probe's frame has the design's axes.

    ``response`` A (n,n) is what face centre i gathers under radiance 1 from cell j,
    ``int_cell j V_i(w) <n_i, w>+ dw``, V_i from the printed geometry (see
    :mod:`~skylight.probes.partitions.printed._printing`).
    """

    cells: Cells
    sizes: ProbeSizes
    pole_mm: Pole
    board_mm: tuple[float, float]
    response: Float[Tensor, "n n"]

    def __post_init__(self) -> None:
        design = self.design
        if design.oriented and self.board_from_probe.angle_deg > _ORIENTED_MOST_DEG:
            raise InputError(f"{design.name}: an oriented probe must not be turned")
        count = design.count
        if self.response.shape != (count, count) or not bool(self.response.isfinite().all()):
            raise InputError(
                f"the response of {count} cells is {count} x {count} finite numbers, got "
                f"{tuple(self.response.shape)}"
            )

    @property
    def design(self) -> ProbeDesign:
        return self.cells.design

    def to_json(self) -> dict[str, object]:
        """What :func:`load_partition_assembly` reads; a file may hold more."""
        return {
            "kind": _KIND,
            "format": _FORMAT,
            "design": {**self.design.to_json(), "labels": self.design.labels.tolist()},
            "sizes": asdict(self.sizes),
            **self.placement_json(),
            "response": self.response.tolist(),
        }

    def placed(self) -> PlacedPartitions:
        """The printed geometry, built anew from design and sizes; takes seconds."""
        pose = self.board_from_probe
        turn, pole_mm = pose.rotation.numpy(), 2 * self.pole_mm[2]
        parts = probe_parts(self.cells, self.sizes, rotation=turn, pole_mm=pole_mm)
        return placed_parts(parts, self.sizes, pose.translation.numpy(), self.pole_mm)


def placed_parts(
    parts: ProbeParts, sizes: ProbeSizes, translation_mm: Float[np.ndarray, " 3"], pole_mm: Pole
) -> PlacedPartitions:
    """Parts, which stand upright already, over the board, with their pole."""
    vertices, triangles, _ = merged(parts.parts)
    pole, strips = cylinder_mesh(pole_mm)
    normals = parts.net.normals
    return PlacedPartitions(
        face_centres=sizes.kernel_mm * normals + translation_mm,
        normals=normals,
        face_radii=face_radii(parts.net, sizes),
        vertices=np.concatenate([vertices + translation_mm, pole]),
        triangles=np.concatenate([triangles, strips + len(vertices)]),
    )


def load_partition_assembly(path: str | Path) -> PartitionAssembly:
    """The assembly that :meth:`PartitionAssembly.to_json` wrote."""
    content = read_object(path, _KIND)
    keys = ["design", "sizes", "rotation", "translation_mm", "pole_mm", "board_mm", "response"]
    require_keys(path, content, ["format", *keys])
    if content["format"] != _FORMAT:
        raise InputError(f"{path}: of format {content['format']}, this program reads {_FORMAT}")
    try:
        if content["pole_mm"] is None or content["board_mm"] is None:
            raise ValueError("pole_mm and board_mm are wanted")
        return PartitionAssembly(
            cells=Cells.of(_read_design(content["design"])),
            sizes=ProbeSizes(**content["sizes"]),  # type: ignore[arg-type]
            response=torch.tensor(content["response"], dtype=torch.float64),
            **read_placement(content),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: its numbers are not those of an assembly ({error})") from error


def _read_design(content: object) -> ProbeDesign:
    """With its cells numbered as in ``response``."""
    if not isinstance(content, dict):
        raise TypeError("the design is no object")
    try:
        return ProbeDesign(
            name=str(content["name"]),
            seeds=torch.tensor(content["seeds"], dtype=torch.float64).reshape(-1, 3),
            labels=torch.tensor(content["labels"], dtype=torch.int64).reshape(-1),
            oriented=bool(content["oriented"]),
        )
    except (KeyError, RuntimeError) as error:
        raise ValueError(f"design: {error}") from error


FLARES = (1.0, 0.9, 0.8, 0.0)  # where none is named, the first with which nothing gets thin
BED_MM = 220.0  # side of the bed of most printers
_WALLS_MM = (1.6, 2 * NOZZLE_MM)  # the second where a probe were larger than the bed
_LEAST_OUTER_MM, _STEP_MM = 80.0, 10.0
_SHELL_TO_KERNEL = 10.0  # diameter of the shell to the distance of the kernel's faces, at least
_LEAST_KERNEL_MM, _MOST_KERNEL_MM, _FINEST_MM, _GROWTH = 4.0, 100.0, 0.1, 1.05
# across: the disc of half of it that is read has 12 pixels at 2 pixels for a mm
_READABLE_MM = 4.0


@dataclass(frozen=True, kw_only=True)
class AskedSizes:
    """What the user of a probe wants, None where its design decides; mm."""

    outer_mm: float | None = None
    kernel_mm: float | None = None
    wall_mm: float | None = None
    clearance_mm: float = 0.15
    flare: float | None = None

    def __post_init__(self) -> None:
        for name in ("outer_mm", "kernel_mm", "wall_mm"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InputError(f"{name} must be a length above 0 mm, got {value:g}")

    @property
    def free(self) -> bool:
        """Whether the design decides on all that it has to fit."""
        return self.outer_mm is None and self.kernel_mm is None and self.wall_mm is None


def fitted_sizes(
    cells: Cells, asked: AskedSizes, *, pole_mm: float, bed_mm: float = BED_MM
) -> ProbeSizes:
    """The smallest sizes to which a design can be printed, with what was asked for as it is.

    The kernel's distance is the least, of 4 mm or more, with which the shell can be made and cut.
    Where faces would have discs of less than 4 mm free, it grows up to a tenth of the shell's
    diameter. That is 80 mm, or ten times the least distance, in full 10 mm. Walls have 1.6 mm, or
    0.8 mm where the shell with its socket would be larger than the bed. What cannot be printed is
    refused, with sizes that can be.
    """
    if not (math.isfinite(bed_mm) and bed_mm > 0):
        raise InputError(f"bed_mm must be a length above 0 mm, got {bed_mm:g}")
    net = WallNet.of(cells, standing_rotation(cells))
    walls = _WALLS_MM if asked.wall_mm is None else (asked.wall_mm,)
    found: list[ProbeSizes] = []
    reasons: list[InputError] = []
    for wall_mm in walls:
        try:
            sizes = _smallest(net, replace(asked, wall_mm=wall_mm), pole_mm)
        except InputError as error:
            reasons.append(error)
            continue
        if sizes.outer_mm + 2 * pole_mm <= bed_mm:
            return sizes
        found.append(sizes)
    if found:
        return min(found, key=lambda sizes: sizes.outer_mm)
    if asked.free:
        raise reasons[0]
    free = AskedSizes(clearance_mm=asked.clearance_mm, flare=asked.flare)
    good = fitted_sizes(cells, free, pole_mm=pole_mm, bed_mm=bed_mm)
    raise InputError(
        f"{reasons[0]}; this design prints with outer_mm {good.outer_mm:g}, kernel_mm "
        f"{good.kernel_mm:g} and wall_mm {good.wall_mm:g}"
    ) from reasons[0]


def _smallest(net: WallNet, asked: AskedSizes, pole_mm: float) -> ProbeSizes:
    """With the walls that were asked for."""
    reason: InputError | None = None
    for kernel_mm in _kernels(asked):
        try:
            sizes = _sized(asked, kernel_mm)
            ShellPlan.of(net, sizes, pole_mm)
        except InputError as error:
            reason = reason or error
            continue
        return sizes if asked.kernel_mm is not None else _readable(net, sizes, pole_mm)
    assert reason is not None
    raise reason


def _kernels(asked: AskedSizes) -> Iterator[float]:
    if asked.kernel_mm is not None:
        yield asked.kernel_mm
        return
    most = _MOST_KERNEL_MM if asked.outer_mm is None else asked.outer_mm / 2
    kernel_mm = _LEAST_KERNEL_MM
    yield kernel_mm
    while kernel_mm < most:
        kernel_mm = _FINEST_MM * math.ceil(_GROWTH * kernel_mm / _FINEST_MM)
        yield round(kernel_mm, 6)


def _sized(asked: AskedSizes, kernel_mm: float) -> ProbeSizes:
    enough = _STEP_MM * math.ceil(_SHELL_TO_KERNEL * kernel_mm / _STEP_MM - 1e-9)
    assert asked.wall_mm is not None
    return ProbeSizes(
        outer_mm=max(_LEAST_OUTER_MM, enough) if asked.outer_mm is None else asked.outer_mm,
        kernel_mm=kernel_mm,
        wall_mm=asked.wall_mm,
        clearance_mm=asked.clearance_mm,
        flare=FLARES[0] if asked.flare is None else asked.flare,
    )


def _readable(net: WallNet, sizes: ProbeSizes, pole_mm: float) -> ProbeSizes:
    """With faces that can be read, where the shell has room for the kernel."""
    larger = sizes
    while 2 * face_radii(net, larger).min() < _READABLE_MM:
        kernel_mm = round(larger.kernel_mm + _FINEST_MM, 6)
        if _SHELL_TO_KERNEL * kernel_mm > sizes.outer_mm:
            break
        larger = replace(larger, kernel_mm=kernel_mm)
    try:
        ShellPlan.of(net, larger, pole_mm)
    except InputError:
        return sizes
    return larger
