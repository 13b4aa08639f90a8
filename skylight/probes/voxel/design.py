"""Beam search for probes of small reconstruction error (left open in thesis, section 3.4.5).

From one voxel, cells that touch the probe are added, one at a time or, for symmetric probes, in
all its 24 rotations; the best few probes of each size are extended further.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.voxel.analysis import LIT, residuals
from skylight.probes.voxel.faces import (
    CONFIGURATIONS,
    NORMALS,
    ORIENTATIONS,
    VoxelFaces,
    exposed_faces,
    quarter_turns,
)
from skylight.probes.voxel.interreflection.global_illumination import ALBEDO
from skylight.probes.voxel.model import VoxelModel
from skylight.sphere.frame import direction_from_angles
from skylight.transport.raycast import Raycaster

_PULLED_IN = 0.1  # of the way from a corner to the face's middle
_GRAZING = 0.15  # cosine below which a face is too oblique to be read


@dataclass(frozen=True, kw_only=True)
class CameraRing:
    """Distant cameras: ``count`` azimuths at each elevation; the lower see what looks down."""

    count: int = 12
    elevations_deg: tuple[float, ...] = (-30.0, 15.0, 35.0, 60.0)

    def directions(self) -> Float[Tensor, "d 3"]:
        """Unit vectors towards the cameras."""
        azimuth = torch.arange(self.count, dtype=torch.float64) * 2 * math.pi / self.count
        zenith = torch.tensor([math.radians(90 - e) for e in self.elevations_deg]).double()
        azimuth, zenith = torch.meshgrid(azimuth, zenith, indexing="ij")
        return direction_from_angles(azimuth, zenith).reshape(-1, 3)


@dataclass(frozen=True, kw_only=True)
class Design:
    """A probe, and its mean squared residual over the lit slots of all orientations."""

    model: VoxelModel
    residual: float


def design_probe(
    voxels: int,
    *,
    size: int = 5,
    symmetric: bool = True,
    beam: int = 8,
    ring: CameraRing | None = None,
    albedo: float = ALBEDO,
) -> Design:
    """The best probe found of up to ``voxels`` cells in a cube of ``size`` cells."""
    if voxels < 1 or size < 1 or size % 2 == 0 or beam < 1:
        raise InputError(
            "a design has 1 voxel or more, an odd grid, and a beam of 1 or more, got "
            f"{voxels}, {size} and {beam}"
        )
    ring = ring or CameraRing()
    seed = np.zeros((size, size, size), bool)
    seed[size // 2, size // 2, size // 2] = True
    layer = [_scored(seed, ring, albedo)]
    best, seen = layer[0], {seed.tobytes()}
    while layer:
        following = []
        for design in layer:
            for grown in _grown_design(design.model.occupied, symmetric):
                if grown.sum() <= voxels and grown.tobytes() not in seen:
                    seen.add(grown.tobytes())
                    following.append(_scored(grown, ring, albedo))
        layer = sorted(following, key=lambda d: d.residual)[:beam]
        best = min([best, *layer], key=lambda d: (d.residual, len(d.model)))
    return Design(model=best.model.cropped(), residual=best.residual)


def probe_residual(
    model: VoxelModel, *, ring: CameraRing | None = None, albedo: float = ALBEDO
) -> float:
    """Mean of ``min |tau_u - T^T x|^2`` over the lit slots, from the faces that the ring sees."""
    faces = exposed_faces(model)
    seen = visible_faces(faces, ring or CameraRing())
    known = torch.zeros(len(ORIENTATIONS), CONFIGURATIONS, dtype=torch.bool)
    known[faces.orientation[seen], faces.configuration[seen]] = True
    known[:, LIT:] = False  # dark: tells nothing
    sets = [torch.nonzero(row).T for row in known]
    return sum(float(residuals(s, albedo=albedo).sum()) for s in sets) / (len(sets) * LIT)


def visible_faces(faces: VoxelFaces, ring: CameraRing) -> Bool[Tensor, " f"]:
    """Faces that one of the cameras at least sees whole: none of the four corners is hidden."""
    caster = Raycaster(*faces.triangles())
    normals = torch.from_numpy(NORMALS[faces.orientation.numpy()]).double()
    middle = faces.corners.mean(1, keepdim=True)
    corners = faces.corners + _PULLED_IN * (middle - faces.corners)
    starts = corners + caster.epsilon * normals[:, None]
    visible = torch.zeros(len(faces), dtype=torch.bool)
    for direction in ring.directions():
        facing = torch.nonzero((normals @ direction > _GRAZING) & ~visible)[:, 0]
        if len(facing):
            hidden = caster.occluded(starts[facing].reshape(-1, 3), direction[None])
            visible[facing] = ~hidden.reshape(-1, 4).any(1)
    return visible


def _scored(occupied: np.ndarray, ring: CameraRing, albedo: float) -> Design:
    model = VoxelModel(occupied=occupied)
    return Design(model=model, residual=probe_residual(model, ring=ring, albedo=albedo))


def _grown_design(occupied: np.ndarray, symmetric: bool) -> Iterator[np.ndarray]:
    """Probes with one more cell beside one of theirs, or with all its turns."""
    turns = quarter_turns() if symmetric else quarter_turns()[:1]
    size, middle = len(occupied), len(occupied) // 2
    for cell in product(range(size), repeat=3):
        if occupied[cell] or not _touches(occupied, np.array(cell)):
            continue
        grown = occupied.copy()
        for turn in turns:
            grown[tuple(turn @ (np.array(cell) - middle) + middle)] = True
        yield grown


def _touches(occupied: np.ndarray, cell: Int[np.ndarray, "3"]) -> bool:
    beside = cell + NORMALS
    beside = beside[((beside >= 0) & (beside < len(occupied))).all(1)]
    return bool(occupied[tuple(beside.T)].any())
