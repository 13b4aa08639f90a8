"""A printed partition probe over its marker board: its file, its solids, and what its faces see."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.cameras.assembly import Pole, ProbeAssembly, cylinder_mesh, read_placement, unoccluded
from skylight.errors import InputError
from skylight.fabrication.part import merged
from skylight.io.json_files import read_object, require_keys
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.printed.halves import ProbeParts, probe_parts
from skylight.probes.partitions.printed.sizes import ProbeSizes
from skylight.probes.partitions.printed.solids import face_radii
from skylight.probes.partitions.seeds import ProbeDesign
from skylight.sphere.rigid_transform import RigidTransform
from skylight.transport.raycast import Raycaster

_KIND, _FORMAT = "partition probe assembly", 1
_ORIENTED_MOST_DEG = 25.0  # as it may be found to stand, of which the user is told


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
    :mod:`~skylight.probes.partitions.printed.visibility`).
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
    """The assembly that :meth:`PartitionAssembly.to_json` wrote.

    Raises
    ------
    InputError
        The file cannot be read as one, or its numbers are no placement.
    """
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
