"""Where a probe really stands, from its own edges in all pictures together.

A round pole leaves the turn about it free, and sockets have play: the board's pose alone puts the
probe where it was meant to stand. Edges of the probe tell better, but those of one picture are
noisier than the board's many corners; what all pictures say together is not.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from skylight.cameras.edges import refine_on_edges
from skylight.cameras.intrinsics import Intrinsics
from skylight.cameras.view import camera_centre
from skylight.probes.voxel.faces import NORMALS
from skylight.probes.voxel.printed.assembly import PlacedProbe, VoxelAssembly
from skylight.sphere.rigid_transform import RigidTransform

PICTURES_MIN = 4  # whose edges could be followed
_AGREE_DEG, _AGREE_MM = 0.5, 1.5  # single pictures differ by 0.1 degrees and 0.4 mm
_FAR_DEG, _FAR_VOXELS = 20.0, 0.5
_WITHIN = 0.1  # share of an edge, at each end, that may be hidden by what it meets
_LIFTED = 0.02  # voxels, off the edge, before looking at it


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """The probe's motion from where it should stand: a rotation about its centre, and a shift.

    Medians over ``pictures``, and the median distance of single pictures from them.
    """

    centre_mm: Float[np.ndarray, "3"]
    turn_deg: Float[np.ndarray, "3"]
    shift_mm: Float[np.ndarray, "3"]
    turn_spread_deg: float
    shift_spread_mm: float
    pictures: int

    @property
    def agrees(self) -> bool:
        """Whether pictures tell about the same, so that it is the probe that stands elsewhere."""
        return self.turn_spread_deg < _AGREE_DEG and self.shift_spread_mm < _AGREE_MM

    def plausible(self, voxel_mm: float) -> bool:
        """Whether it is small enough that edges were not taken for others, which look alike."""
        near = float(np.linalg.norm(self.shift_mm)) < _FAR_VOXELS * voxel_mm
        return near and float(np.linalg.norm(self.turn_deg)) < _FAR_DEG

    def trusted(self, voxel_mm: float) -> bool:
        """Whether it is to be applied."""
        return self.agrees and self.plausible(voxel_mm)

    @property
    def motion(self) -> RigidTransform:
        """In the board's frame."""
        vector = torch.from_numpy(np.concatenate([np.radians(self.turn_deg), self.shift_mm]))
        return RigidTransform.from_vector(vector).about(torch.from_numpy(self.centre_mm))

    def applied(self, assembly: VoxelAssembly) -> VoxelAssembly:
        """The probe where its edges show it."""
        return replace(assembly, board_from_probe=self.motion @ assembly.board_from_probe)


def edges_of(
    probe: PlacedProbe,
) -> tuple[Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 3"]]:
    """(ends, outward directions) of the edges between faces of different orientation, mm."""
    faces = probe.faces
    corners = (2 * faces.corners).round().long().tolist()  # whole numbers, to compare
    normals = NORMALS[faces.orientation.numpy()]
    around: dict[frozenset[tuple[int, ...]], list[int]] = {}
    for i, square in enumerate(corners):
        for a, b in zip(square, [*square[1:], square[0]], strict=True):
            around.setdefault(frozenset([tuple(a), tuple(b)]), []).append(i)
    ends, outward = [], []
    for edge, sides in around.items():
        if len(np.unique(normals[sides], axis=0)) > 1:
            ends.append(sorted(edge))
            outward.append(normals[sides].mean(0))
    assembly = probe.assembly
    placed = assembly.to_board(np.array(ends) / 2)
    return placed, assembly.board_from_probe.directions(np.array(outward))


def visible_edges(
    probe: PlacedProbe,
    eye: Float[np.ndarray, "3"],
    ends: Float[np.ndarray, "n 2 3"],
    outward: Float[np.ndarray, "n 3"],
) -> Bool[np.ndarray, " n"]:
    """Those of which nothing hides three places from the eye."""
    share = np.array([_WITHIN, 0.5, 1 - _WITHIN])[:, None]
    places = ends[:, :1] * (1 - share) + ends[:, 1:] * share
    places = places + _LIFTED * probe.assembly.voxel_mm * outward[:, None]
    return np.asarray(probe.sees(eye, places).numpy().all(1))


class Aligner:
    """Gathers what each picture's edges say about where the probe stands."""

    def __init__(self, probe: PlacedProbe, intrinsics: Intrinsics) -> None:
        self._probe, self._intrinsics = probe, intrinsics
        self._ends, self._outward = edges_of(probe)
        self._centre = torch.from_numpy(self._ends.reshape(-1, 3).mean(0))
        self._turns: list[np.ndarray] = []
        self._shifts: list[np.ndarray] = []

    def add(self, image: UInt8[np.ndarray, "h w 3"], board: RigidTransform) -> bool:
        """Whether this picture's edges could be followed, from the board's pose on."""
        visible = visible_edges(self._probe, camera_centre(board), self._ends, self._outward)
        fit = refine_on_edges(image, board, self._intrinsics, self._ends, visible)
        if not fit.converged:
            return False
        # from where the probe was meant to stand to where it does, in the board's frame
        motion = (board.inverse() @ fit.pose).about(-self._centre)
        self._turns.append(np.degrees(motion.rotation_vector.numpy()))
        self._shifts.append(motion.translation.numpy())
        return True

    def alignment(self) -> Alignment | None:
        """What all pictures say together; None of fewer than :data:`PICTURES_MIN`."""
        if len(self._turns) < PICTURES_MIN:
            return None
        turns, shifts = np.array(self._turns), np.array(self._shifts)
        turn, shift = np.median(turns, 0), np.median(shifts, 0)
        return Alignment(
            centre_mm=self._centre.numpy(),
            turn_deg=turn,
            shift_mm=shift,
            turn_spread_deg=float(np.median(np.linalg.norm(turns - turn, axis=1))),
            shift_spread_mm=float(np.median(np.linalg.norm(shifts - shift, axis=1))),
            pictures=len(turns),
        )
