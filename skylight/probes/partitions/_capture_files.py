"""The shading of a printed partition probe from photographs or a film, files to files."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes._capture import CaptureResult, PosedFrames, place_found, write_capture
from skylight.probes._chart import Rectangle
from skylight.probes.cameras._files import MOVED, Setup, require_capture
from skylight.probes.cameras._live import FRAMES_MOST, Frame, read_picture
from skylight.probes.cameras._response import Response, load_response
from skylight.probes.partitions._alignment import PartitionAligner, PartitionAlignment
from skylight.probes.partitions._captured import (
    LEAST_AREA_PX,
    ProbeCapture,
    SampleCapture,
    complete_shading,
    load_capture,
    name_cells,
    save_capture,
)
from skylight.probes.partitions._kernel_albedo import (
    KernelAlbedo,
    albedo_beside_card,
    albedo_beside_chart,
    save_albedo,
)
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.printed._assembly import PartitionAssembly, load_partition_assembly
from skylight.work._progress import Tell

_TURNED_DEG = 3.0  # more is no play of sockets
_UNSURE = 0.05  # standard error of an albedo, of itself


@dataclass(frozen=True, kw_only=True)
class PartitionCaptureResult(CaptureResult):
    """The shading that pictures told, and how the probe stood."""

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
        told = f"{known.sum()} of {len(known)} cells from {len(self.used)} pictures"
        if alignment.rejection is not None:
            return told
        every, motion = alignment.same_every_deg, alignment.fit.motion
        alike = f" (or a multiple of {every:g} more: its edges are alike)" if every < 360 else ""
        turn, shift = float(motion.angle_deg), float(motion.translation.norm())
        return f"{told}; {place_found(turn, shift, alike)}"


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
    """
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
    """The shading of all cells, those that are missing from the smoothest light, which is said.

    Raises
    ------
    InputError
        The capture is of another probe, or less than half of the cells are known.
    """
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


def measure_albedo(
    photo: Path,
    out: Path,
    *,
    patch: Rectangle,
    card: Rectangle | None,
    card_albedo: float | None,
    response: Path | None,
    warn: Tell = print,
) -> KernelAlbedo:
    """Write ``out`` (.json): the albedo of what ``patch`` shows, against a card or a ColorChecker.

    Raises
    ------
    InputError
        The photo does not show what is needed, well exposed.
    """
    if (card is None) != (card_albedo is None):
        raise InputError("give --card and --card-albedo together, or neither with a ColorChecker")
    curve = Response() if response is None else load_response(response)
    image = read_picture(photo).image
    if card is None or card_albedo is None:
        found = albedo_beside_chart(image, curve, patch)
    else:
        found = albedo_beside_card(image, curve, patch, card, card_albedo)
    save_albedo(out, found)
    worst = float((found.error / found.rgb).max())
    if worst > _UNSURE:
        warn(
            f"the albedo is known to {worst:.0%} only: light it evenly, and check the response "
            "and the rectangles"
        )
    return found


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
