"""The shading of a printed partition probe from photographs or a film, files to files.

Where the probe really stands is found first, by its white faces against the black walls.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from skylight.errors import InputError, not_installed
from skylight.io._bounded import write_json
from skylight.probes._capture import CaptureResult, PosedFrames, place_found, write_capture
from skylight.probes.cameras._alignment import Outline, OutlineAligner, OutlineFit
from skylight.probes.cameras._files import MOVED, Setup, require_capture
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._live import FRAMES_MOST, Frame
from skylight.probes.partitions._captured import (
    LEAST_AREA_PX,
    ProbeCapture,
    SampleCapture,
    complete_shading,
    load_capture,
    name_cells,
    save_capture,
)
from skylight.probes.partitions._kernel_albedo import KernelAlbedo
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.printed._assembly import (
    PartitionAssembly,
    PlacedPartitions,
    load_partition_assembly,
)
from skylight.probes.partitions.printed._solids import (
    ProbeSizes,
    WallNet,
    kernel_planes,
    sector_distance,
)
from skylight.work._progress import Tell

_SPACING_MM = 0.6
_CLEAR_MM = 0.4  # of other walls, where edges meet
_BESIDE_MM = 0.05  # a wall's plane, to be on one of the faces that meet there
_COVERED_MM = 0.5  # beyond a wall's own half, by walls that are seen from aside
_ORDERS = range(12, 1, -1)
_SAME_MM = 1.0  # outlines that are no further apart are taken for the same
_ORIENTED_RANGE_DEG = 20.0  # its turn is given by the world
SHOWN = 0.35  # share of the outline that must be where it should; of other things about a tenth is
_FEWEST = 40  # places
_CLEAR_SHARE, _CLEARLY, _APART_DEG = 0.5, 0.1, 8.0
_SURE_DEG, _FAR_LEAN_DEG, _FAR_MM = 1.0, 5.0, 6.0


@dataclass(frozen=True, kw_only=True)
class PartitionAlignment:
    """What the outlines of the faces say, in all pictures together.

    ``fit`` is the best one found, ``unmoved`` that of the assembly's own word; ``rival_share`` is
    that of the best other turn. Turns by ``same_every_deg`` look alike, and the smallest was taken.
    """

    fit: OutlineFit
    unmoved: OutlineFit
    rival_share: float
    same_every_deg: float

    @property
    def stands(self) -> OutlineFit:
        """What is to be taken for the probe's place."""
        return self.fit if self.rejection is None else self.unmoved

    @property
    def shown(self) -> bool:
        """Whether the probe is near where it should be; so if too little is in view to tell."""
        if self.unmoved.places.sum() < _FEWEST or max(self.fit.share, self.unmoved.share) > SHOWN:
            return True
        return bool((self.shown_in & (self.stands.places >= _FEWEST)).any())

    @property
    def shown_in(self) -> Bool[np.ndarray, " v"]:
        """Whether each picture shows the probe at :attr:`stands`, or too little of it to tell."""
        places, agree = self.stands.places, self.stands.agree
        return np.asarray((places < _FEWEST) | (agree >= SHOWN * places))

    @property
    def turn_deg(self) -> float:
        """About the pole, seen from above anticlockwise."""
        return float(self.fit.turn_deg[1])

    @property
    def rejection(self) -> str | None:
        """Why the fit is not applied; None where it is."""
        fit = self.fit
        lean = float(np.linalg.norm(fit.turn_deg[[0, 2]]))
        shift = float(np.linalg.norm(fit.shift_mm))
        if fit.agree.sum() < _FEWEST or fit.share < _CLEAR_SHARE:
            return f"{fit.agree.sum()} of {fit.places.sum()} places on edges agree"
        if not fit.turn_error_deg < _SURE_DEG:
            return f"they leave the turn uncertain by {fit.turn_error_deg:.1f} degrees"
        if self.rival_share > fit.share - _CLEARLY:
            return "another turn fits them about as well"
        if lean > _FAR_LEAN_DEG or shift > _FAR_MM:
            return f"they would have it lean by {lean:.0f} degrees and {shift:.0f} mm off its place"
        return None


class PartitionAligner(OutlineAligner):
    """Finds turn about the pole, small lean and shift of a probe, about its centre."""

    def __init__(
        self, assembly: PartitionAssembly, placed: PlacedPartitions, intrinsics: Intrinsics
    ) -> None:
        pose = assembly.board_from_probe
        outline = outline_of(WallNet.of(assembly.cells, pose.rotation.numpy()), assembly.sizes)
        self._range, self._every = _ORIENTED_RANGE_DEG, 360.0
        if not assembly.design.oriented:
            self._every = 360 / symmetry(outline)
            self._range = self._every / 2
        at = replace(outline, places=outline.places + pose.translation.numpy())
        super().__init__(at, placed.sees, pose.translation, intrinsics)

    def alignment(self) -> PartitionAlignment:
        """What all pictures say together."""
        unmoved = self.unmoved()
        fits = self.best(self._range) or [unmoved]
        best = fits[0]
        others = [fit.share for fit in fits[1:] if self._apart(fit, best)]
        return PartitionAlignment(
            fit=best,
            unmoved=unmoved,
            rival_share=max(others, default=0.0),
            same_every_deg=self._every,
        )

    def _apart(self, one: OutlineFit, other: OutlineFit) -> bool:
        turn = (one.turn_deg[1] - other.turn_deg[1]) % self._every
        return bool(min(turn, self._every - turn) > _APART_DEG)


def outline_of(net: WallNet, sizes: ProbeSizes) -> Outline:
    """Where the kernel's faces meet below walls, about its centre: on both sides, every 0.6 mm.

    The kernel's surface {min_k kernel_mm - <x, n_k> = 0} is cut by each wall's plane. Walls end
    above it and hide it up to their thickness, by where they are seen from.
    """
    planes = kernel_planes(net)
    covered = sizes.wall_mm / 2 + _COVERED_MM
    found = []
    for wall, start in enumerate(net.ends_of_walls[:, 0]):
        angle = net.lengths_rad[wall]
        count = max(2, math.ceil(angle * sizes.kernel_mm / _SPACING_MM))
        at = angle * (np.arange(count) + 0.5) / count
        across = np.cross(net.poles[wall], start)
        for side, cell in ((1.0, net.left[wall]), (-1.0, net.right[wall])):
            foot = side * _BESIDE_MM * net.poles[wall]
            ways = np.cos(at)[:, None] * start + np.sin(at)[:, None] * across
            slope = ways @ planes.T
            ahead = slope > 1e-6
            reach = (sizes.kernel_mm - planes @ foot) / np.where(ahead, slope, 1.0)
            reach = np.where(ahead, reach, np.inf)
            outward = planes[reach.argmin(1)]
            places = foot + reach.min(1)[:, None] * ways
            along = np.cross(outward, net.poles[wall])
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            into = side * np.cross(along, outward)
            into *= np.sign(side * (into @ net.poles[wall]))[:, None]
            free = _clear(places, net, sizes, wall, int(cell))
            piece = Outline(
                places=places, along=along, into=into, outward=outward, covered_mm=covered
            )
            found.append(piece.only(free))
    return Outline(
        places=np.concatenate([each.places for each in found]),
        along=np.concatenate([each.along for each in found]),
        into=np.concatenate([each.into for each in found]),
        outward=np.concatenate([each.outward for each in found]),
        covered_mm=covered,
    )


def _clear(
    places: Float[np.ndarray, "p 3"], net: WallNet, sizes: ProbeSizes, wall: int, cell: int
) -> np.ndarray:
    """Which places are free of the other walls round a cell."""
    others = np.flatnonzero((net.left == cell) | (net.right == cell))
    others = others[others != wall]
    p, w = len(places), len(others)
    away = sector_distance(
        np.repeat(places, w, 0),
        np.tile(net.ends_of_walls[others], (p, 1, 1)),
        np.tile(net.poles[others], (p, 1)),
    ).reshape(p, w)
    return np.asarray((away > sizes.wall_mm / 2 + _CLEAR_MM).all(1))


def symmetry(outline: Outline) -> int:
    """How many turns about the vertical bring an outline about its centre onto itself."""
    tree = KDTree(outline.places)
    for order in _ORDERS:
        turned = outline.places @ Rotation.from_euler("y", 2 * np.pi / order).as_matrix().T
        if tree.query(turned)[0].max() < _SAME_MM:
            return order
    return 1


_TURNED_DEG = 3.0  # more is no play of sockets


@dataclass(frozen=True, kw_only=True)
class PartitionCaptureResult(CaptureResult):
    """The shading read from pictures, and how the probe stood."""

    capture: ProbeCapture
    assembly: PartitionAssembly
    alignment: PartitionAlignment

    def save(self, folder: Path) -> None:
        save_capture(folder / "shading.json", self.capture)
        write_json(folder / "assembly.json", self.assembly.to_json())

    def describe(self) -> dict[str, object]:
        alignment = self.alignment
        return {
            "cells": len(self.capture.known),
            "captured": int(self.capture.known.sum()),
            "alignment": {
                "turn_deg": alignment.fit.turn_deg.tolist(),
                "shift_mm": alignment.fit.shift_mm.tolist(),
                "share_of_outline": alignment.fit.share,
                "share_unmoved": alignment.unmoved.share,
                "same_every_deg": alignment.same_every_deg,
                "applied": alignment.rejection is None,
            },
        }

    def summary(self) -> str:
        known, alignment = self.capture.known, self.alignment
        found = f"{known.sum()} of {len(known)} cells from {len(self.used)} pictures"
        if alignment.rejection is not None:
            return found
        every, motion = alignment.same_every_deg, alignment.fit.motion
        alike = f" (or a multiple of {every:g} more: its edges are alike)" if every < 360 else ""
        turn, shift = float(motion.angle_deg), float(motion.translation.norm())
        return f"{found}; {place_found(turn, shift, alike)}"


def capture_partition_probe(
    source: Path | Sequence[Path] | int,
    *,
    setup: Setup,
    assembly: Path,
    out: Path,
    albedo: KernelAlbedo,
    most: int = FRAMES_MOST,
    more: bool = False,
    tell: Tell = print,
    warn: Tell = print,
) -> PartitionCaptureResult:
    """shading.json, capture.json and assembly.json in ``out``.

    ``more`` adds to an earlier capture: a cell's shading is replaced where a new
    picture shows its face larger. assembly.json has the probe where it was found to stand.

    Raises
    ------
    InputError
        No picture shows the board and the probe, or a file cannot be used; nothing is written.
    DependencyError
        manifold3d, by which the walls that hide faces are made, is not installed.
    """
    if find_spec("manifold3d") is None:  # walls are made after pictures were read
        raise not_installed("manifold3d")
    before = out / "shading.json"
    require_capture(before, more=more, most=most)
    printed = load_partition_assembly(assembly)
    printed.require_board(setup.board.size_mm)
    start = load_capture(before) if more else ProbeCapture.blank(printed.design, albedo.rgb)
    start.require_design(printed.design)
    if not torch.equal(start.albedo, albedo.rgb):
        raise InputError(f"{before} was captured with another --albedo: give the same")
    return write_capture(
        source,
        out,
        lambda frames: capture_faces(frames, printed, setup, start),
        most=most,
        more=more,
        tell=tell,
        warn=warn,
    )


def capture_faces(
    frames: Iterable[Frame], assembly: PartitionAssembly, setup: Setup, start: ProbeCapture
) -> PartitionCaptureResult:
    """Everything that pictures tell; the outlines of the faces say where the probe stands."""
    pictures = PosedFrames.of(frames, setup)
    placed = assembly.placed()
    aligner = PartitionAligner(assembly, placed, setup.intrinsics)
    for frame, pose in pictures.seen:
        aligner.add(frame.image, pose)
    alignment = aligner.alignment()
    if not alignment.shown:
        raise InputError(
            f"no probe where the assembly says, in any of {len(pictures.seen)} pictures: the edges "
            "of its white faces are not there; stand it on the board, and check that the assembly "
            "is its"
        )
    if alignment.rejection is None:
        motion = alignment.fit.motion.about(assembly.board_from_probe.translation)
        # not built anew: pins are where they were printed
        placed = placed.moved(motion)
        assembly = replace(assembly, board_from_probe=motion @ assembly.board_from_probe)
    pictures = pictures.only(alignment.shown_in.tolist(), "no probe where the others show it")
    capture = SampleCapture(placed, start)
    for frame, pose in pictures.seen:
        capture.add_photo(frame.image, setup.response, pose, setup.intrinsics)
    captured = capture.captured()
    if not captured.known.any():
        burnt, small = int(capture.rejected.sum()), int(capture.small.sum())
        if burnt:
            raise InputError(f"all {burnt} faces in view are over-exposed: expose shorter")
        if small:
            raise InputError(f"all {small} faces in view are too small: come closer")
        raise InputError(
            f"no face of the kernel is seen whole in any of {len(pictures.seen)} pictures: look "
            "into the cells, and check that the assembly is that of the probe"
        )
    return PartitionCaptureResult(
        capture=captured,
        assembly=assembly,
        used=pictures.used,
        left_out=pictures.left_out,
        warnings=_alignment_warnings(alignment, assembly)
        + _capture_warnings(captured, capture.small, torch.from_numpy(placed.normals)),
        alignment=alignment,
    )


def completed_shading(
    capture: ProbeCapture, assembly: PartitionAssembly, probe: PartitionProbe, warn: Tell
) -> Float[Tensor, "n 3"]:
    """The shading of all cells, those that are missing from the smoothest light, which is said."""
    capture.require_design(assembly.design)
    shading = complete_shading(capture.shading, capture.known, probe)
    missing = ~capture.known
    if missing.any():
        normals = assembly.board_from_probe.directions(probe.cells.normals)
        named = name_cells(missing, normals)
        warn(
            f"{missing.sum()} of {len(missing)} cells were not captured and get the mean light of "
            f"their neighbours: {named}"
        )
    return shading


def _alignment_warnings(alignment: PartitionAlignment, assembly: PartitionAssembly) -> list[str]:
    if alignment.rejection is not None:
        return [
            "the edges of the probe's faces do not tell where it stands "
            f"({alignment.rejection}): the assembly's pose is used; add pictures from all round"
        ]
    if assembly.design.oriented and abs(alignment.turn_deg) > _TURNED_DEG:
        return [
            f"the probe is turned by {alignment.turn_deg:.0f} degrees about its pole, and its "
            "design belongs to the world's directions: turn its -Z north again, with the board"
        ]
    return []


def _capture_warnings(
    captured: ProbeCapture,
    small: Bool[Tensor, " n"],
    normals: Float[Tensor, "n 3"],
) -> list[str]:
    warnings = []
    n = len(captured.known)
    burnt = captured.saturated & ~captured.known
    small = small & ~burnt & ~captured.known
    unseen = ~(captured.known | burnt | small)
    if unseen.any():
        warnings.append(
            f"{unseen.sum()} of {n} cells are seen in no picture: {name_cells(unseen, normals)}; "
            "add pictures from there with --more"
        )
    if small.any():
        warnings.append(
            f"{small.sum()} cells are below {LEAST_AREA_PX:g} square pixels in every picture: "
            f"{name_cells(small, normals)}; come closer"
        )
    if burnt.any():
        warnings.append(
            f"{burnt.sum()} cells are over-exposed in every picture: "
            f"{name_cells(burnt, normals)}; expose shorter"
        )
    # without any second view, a comparison with NaN is False
    moved = captured.disagreement > MOVED
    if moved.any():
        worst = float(captured.disagreement[moved].max())
        warnings.append(
            f"{moved.sum()} of {n} cells differ between pictures, by up to {worst:.0%}: "
            f"{name_cells(moved, normals)}; the light moved or changed, the exposure was not "
            "fixed, or the probe stands elsewhere than the assembly says"
        )
    return warnings
