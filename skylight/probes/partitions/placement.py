"""Where a printed partition probe stands over its marker board, and what its faces see."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.capture.json_files import read_object, require_keys
from skylight.probes.capture.standing import (
    Pole,
    cylinder_mesh,
    read_stand,
    require_board,
    require_rigid,
    unhidden,
)
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design import ProbeDesign
from skylight.probes.partitions.halves import ProbeParts, probe_parts
from skylight.probes.partitions.sizes import ProbeSizes
from skylight.probes.partitions.solids import face_radii
from skylight.probes.printing.part import merged
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
        return unhidden(self.caster, eye, points)


@dataclass(frozen=True, kw_only=True, eq=False)
class StandingPartitions:
    """What was printed and where it stands: a point x of the probe at ``rotation x + translation``.

    ``pole_mm`` is a cylinder (centre x, centre z, radius, height), upright on the board of
    ``board_mm`` (width, height of the pattern). ``response`` A (n,n) is what face centre i
    gathers under radiance 1 from cell j, ``int_cell j V_i(w) <n_i, w>+ dw``, V_i from the printed
    geometry (see :mod:`~skylight.probes.partitions.visibility`).
    """

    design: ProbeDesign
    sizes: ProbeSizes
    rotation: Float[np.ndarray, "3 3"]
    translation_mm: Float[np.ndarray, " 3"]
    pole_mm: Pole
    board_mm: tuple[float, float]
    response: Float[Tensor, "n n"]

    def __post_init__(self) -> None:
        require_rigid(self.rotation, self.translation_mm)
        turned = Rotation.from_matrix(self.rotation).magnitude()
        if self.design.oriented and turned > math.radians(_ORIENTED_MOST_DEG):
            raise InputError(f"{self.design.name}: an oriented probe must not be turned")
        count = self.design.count
        if self.response.shape != (count, count) or not bool(self.response.isfinite().all()):
            raise InputError(
                f"the response of {count} cells is {count} x {count} finite numbers, got "
                f"{tuple(self.response.shape)}"
            )

    def require_board(self, size_mm: tuple[float, float]) -> None:
        """Refuse a board of another size than the one the probe stands on."""
        require_board(self.board_mm, size_mm)

    def to_board(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """From the probe's frame (its centre, the design's axes, mm)."""
        return points @ self.rotation.T + self.translation_mm

    def placed(self) -> PlacedPartitions:
        """The printed geometry, built anew from design and sizes; takes seconds."""
        cells = Cells.of(self.design)
        parts = probe_parts(cells, self.sizes, rotation=self.rotation, pole_mm=2 * self.pole_mm[2])
        return placed_parts(parts, self.sizes, self.translation_mm, self.pole_mm)


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


def describe_standing_partitions(probe: StandingPartitions) -> dict[str, object]:
    """What :func:`load_standing_partitions` reads; a file may say more."""
    return {
        "kind": _KIND,
        "format": _FORMAT,
        "design": {**probe.design.to_json(), "labels": probe.design.labels.tolist()},
        "sizes": asdict(probe.sizes),
        "rotation": probe.rotation.tolist(),
        "translation_mm": probe.translation_mm.tolist(),
        "pole_mm": list(probe.pole_mm),
        "board_mm": list(probe.board_mm),
        "response": probe.response.tolist(),
    }


def load_standing_partitions(path: str | Path) -> StandingPartitions:
    """A probe as :func:`describe_standing_partitions` tells it, from JSON.

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
        rotation, translation, pole, board = read_stand(content)
        response = torch.tensor(content["response"], dtype=torch.float64)
        sizes = ProbeSizes(**content["sizes"])  # type: ignore[arg-type]
        if pole is None or board is None:
            raise ValueError("pole_mm and board_mm are wanted")
        return StandingPartitions(
            design=_read_design(content["design"]),
            sizes=sizes,
            rotation=rotation,
            translation_mm=translation,
            pole_mm=pole,
            board_mm=board,
            response=response,
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
