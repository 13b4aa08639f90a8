"""Shading copied from pictures of a voxel probe into its lightmap, and where the probe stands.

Of each slot the largest view is kept (thesis, section 3.5.2). A round pole leaves the turn about it
free, and sockets have play: the board's pose alone puts the probe where it was meant to stand.
Edges of the probe tell better, but those of one picture are noisier than the board's many corners;
what all pictures say together is not.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.probes._capture import faces_in_view, polygon_areas
from skylight.probes.cameras._edges import refine_on_edges
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._pose import camera_centre, in_frame, part_around, project
from skylight.probes.cameras._response import Response, saturated
from skylight.probes.voxel._assembly import PlacedProbe, VoxelAssembly
from skylight.probes.voxel._lightmap import SIZE, Lightmap
from skylight.probes.voxel._model import CONFIGURATIONS, NORMALS, ORIENTATIONS, places_on
from skylight.sphere._rotation import RigidTransform

_INSET = 0.04  # of a face: what lies nearer to its edge may belong to what is beyond
_SAMPLES = 4  # along each side of a texel
_LEAST_COVERAGE = 0.75


@dataclass(frozen=True, kw_only=True)
class FaceView:
    """One face in one picture: its slot, its size on screen and its shading."""

    face: int
    orientation: int
    configuration: int
    area_px: float
    radiance: Float[Tensor, "n n 3"]
    valid: Bool[Tensor, "n n"]

    @property
    def mean(self) -> Float[Tensor, "3"]:
        return self.radiance[self.valid].mean(0)


def visible_faces(
    probe: PlacedProbe, pose: RigidTransform, intrinsics: Intrinsics
) -> tuple[list[int], Float[np.ndarray, "f 4 2"], Float[np.ndarray, " f"]]:
    """(faces that a picture shows whole, all corners in it, areas on screen in px^2).

    Nothing is between the camera and a face's corners, the middles of its sides and its own middle.
    """
    corners, middles = probe.corners, probe.corners.mean(1)
    pixels, _ = in_frame(corners, pose, intrinsics)
    nine = np.concatenate(
        [corners, 0.5 * (corners + np.roll(corners, 1, axis=1)), middles[:, None]], 1
    )
    # a hair inwards: an edge belongs to the neighbouring face as well
    nine = nine + 0.02 * (middles[:, None] - nine)
    shown = faces_in_view(middles, probe.normals, corners, nine, probe.sees, pose, intrinsics)
    return shown, pixels, polygon_areas(pixels)


def read_faces(
    picture: Float[np.ndarray, "h w 3"],
    clipped: Bool[np.ndarray, "h w"],
    probe: PlacedProbe,
    pose: RigidTransform,
    intrinsics: Intrinsics,
    *,
    size: int = SIZE,
) -> list[FaceView]:
    """The shading of all faces that a linear picture shows whole.

    Every texel is the mean of 4 x 4 bilinear samples, each at its own place through the lens'
    distortion. Samples within 4 % of a face's edge are taken 4 % from it, so that a pose that is
    off by little does not bring in what is beyond; the thesis shrinks the whole face instead.
    """
    shown, _, areas = visible_faces(probe, pose, intrinsics)
    return _sampled(picture, clipped, (0, 0), probe, pose, intrinsics, shown, areas, size)


def _sampled(
    picture: Float[np.ndarray, "h w 3"],
    clipped: Bool[np.ndarray, "h w"],
    corner: tuple[int, int],
    probe: PlacedProbe,
    pose: RigidTransform,
    intrinsics: Intrinsics,
    shown: list[int],
    areas: Float[np.ndarray, " f"],
    size: int,
) -> list[FaceView]:
    """:func:`read_faces` of faces known to be shown, from pixels that begin at (column, row)."""
    orientation, configuration = probe.faces.orientation, probe.faces.configuration
    if not shown:
        return []
    along = (torch.arange(size * _SAMPLES, dtype=torch.float64) + 0.5) / (size * _SAMPLES)
    along = along.clamp(_INSET, 1 - _INSET)
    points = places_on(torch.from_numpy(probe.corners[shown]), along).numpy()
    places = project(points.reshape(-1, 3), pose, intrinsics) - np.array(corner)
    places = places.astype(np.float32)
    places = places.reshape(len(shown), -1, size * _SAMPLES, 2)
    # one face below the other, as one picture
    x, y = (places[..., axis].reshape(-1, size * _SAMPLES) for axis in (0, 1))
    source = np.ascontiguousarray(picture, dtype=np.float32)
    colours = _binned(cv2.remap(source, x, y, cv2.INTER_LINEAR)).reshape(-1, size, size, 3)
    burnt = _binned(cv2.remap(clipped.astype(np.float32), x, y, cv2.INTER_LINEAR))
    valid = burnt.reshape(-1, size, size) == 0
    return [
        FaceView(
            face=face,
            orientation=int(orientation[face]),
            configuration=int(configuration[face]),
            area_px=float(areas[face]),
            radiance=torch.from_numpy(colours[i]),
            valid=torch.from_numpy(valid[i]),
        )
        for i, face in enumerate(shown)
    ]


class LightmapCapture:
    """Accumulates a lightmap over pictures: of each slot, its largest view."""

    def __init__(self, probe: PlacedProbe, start: Lightmap | None = None) -> None:
        self.probe = probe
        lightmap = start or Lightmap.blank()
        self.size = lightmap.size
        self._radiance = lightmap.radiance.clone()
        self._coverage = lightmap.coverage.clone()
        self._area = lightmap.confidence * self.size**2
        self.rejected = torch.zeros(len(ORIENTATIONS), CONFIGURATIONS, dtype=torch.bool)
        """Unknown slots of which some view was over-exposed."""
        self.disagreements: list[float] = []
        """For each face seen again: relative difference of its mean from that of the view kept."""
        self._face = lightmap.faces.clone()

    def add(
        self,
        picture: Float[np.ndarray, "h w 3"],
        clipped: Bool[np.ndarray, "h w"],
        pose: RigidTransform,
        intrinsics: Intrinsics,
    ) -> int:
        """Copy what this linear picture shows larger than any before; how many slots it gave."""
        return self._keep(
            read_faces(picture, clipped, self.probe, pose, intrinsics, size=self.size)
        )

    def add_photo(
        self,
        image: UInt8[np.ndarray, "h w 3"],
        response: Response,
        pose: RigidTransform,
        intrinsics: Intrinsics,
        *,
        compare: bool = True,
    ) -> int:
        """:meth:`add` of a picture as the camera gave it; only the probe's part is linearised.

        Without ``compare``, faces that were seen larger before are not looked at, which is all the
        same but for :attr:`disagreements`.
        """
        shown, pixels, areas = visible_faces(self.probe, pose, intrinsics)
        if not compare:
            faces = self.probe.faces
            kept = self._area[faces.orientation[shown], faces.configuration[shown]].tolist()
            shown = [f for f, area in zip(shown, kept, strict=True) if areas[f] > area]
        if not shown:
            return 0
        codes, corner = part_around(image, pixels[shown])
        linear = response.linearise(codes).numpy()
        views = _sampled(
            linear, saturated(codes), corner, self.probe, pose, intrinsics, shown, areas,
            self.size,
        )  # fmt: skip
        return self._keep(views)

    def _keep(self, views: list[FaceView]) -> int:
        taken = 0
        for view in sorted(views, key=lambda v: v.area_px):
            slot = view.orientation, view.configuration
            share = float(view.valid.double().mean())
            if share < _LEAST_COVERAGE:
                self.rejected[slot] |= self._coverage[slot] == 0
                continue
            if self._face[slot] == view.face:
                kept = self._radiance[slot].mean((0, 1))
                apart = (view.mean / kept.clamp(min=1e-6) - 1).abs().max()
                self.disagreements.append(float(apart))
            if view.area_px <= self._area[slot]:
                continue
            # what the camera clipped is at least as bright as the brightest that it did not
            brightest = view.radiance[view.valid].amax(0)
            self._radiance[slot] = torch.where(view.valid[..., None], view.radiance, brightest)
            self._coverage[slot], self._area[slot] = share, view.area_px
            self.rejected[slot], self._face[slot] = False, view.face
            taken += 1
        return taken

    @property
    def slots(self) -> int:
        """How many are known."""
        return int((self._coverage > 0).sum())

    def lightmap(self) -> Lightmap:
        """What was captured so far."""
        return Lightmap(
            radiance=self._radiance.clone(),
            coverage=self._coverage.clone(),
            confidence=self._area / self.size**2,
            faces=self._face.clone(),
            rotation=self.probe.assembly.board_from_probe.rotation,
        )


def _binned(fine: np.ndarray) -> np.ndarray:
    """Means over the samples of each texel."""
    down, across = (side // _SAMPLES for side in fine.shape[:2])
    return np.asarray(cv2.resize(fine, (across, down), interpolation=cv2.INTER_AREA))


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

    def describe(self) -> dict[str, object]:
        """In plain numbers."""
        return {
            "turn_deg": self.turn_deg.tolist(),
            "shift_mm": self.shift_mm.tolist(),
            "turn_spread_deg": self.turn_spread_deg,
            "shift_spread_mm": self.shift_spread_mm,
            "pictures": self.pictures,
        }

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
