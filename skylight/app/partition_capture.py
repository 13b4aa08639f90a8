"""The shading of a printed partition probe from photographs or a film, files to files."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight import __version__
from skylight.app.board_pictures import (
    MOVED,
    BoardPictures,
    Setup,
    Tell,
    require_capture,
    tell_doubts,
)
from skylight.app.results import results_folder
from skylight.errors import InputError
from skylight.imaging.files import write_json
from skylight.probes.capture.frames import FRAMES_MOST, Frame, read_frames, read_picture
from skylight.probes.capture.response import Response, load_response
from skylight.probes.partitions.capture import LEAST_AREA_PX, SampleCapture
from skylight.probes.partitions.kernel_albedo import (
    KernelAlbedo,
    Rectangle,
    albedo_beside_card,
    albedo_beside_chart,
    save_albedo,
)
from skylight.probes.partitions.placement import (
    StandingPartitions,
    describe_standing_partitions,
    load_standing_partitions,
)
from skylight.probes.partitions.probe import PartitionProbe
from skylight.probes.partitions.samples import (
    ProbeCapture,
    completed,
    load_capture,
    name_cells,
    save_capture,
)

_UNSURE = 0.05  # standard error of an albedo, of itself


@dataclass(frozen=True, kw_only=True)
class PartitionCaptureResult:
    """``doubts`` are sentences for the user, empty when all went well."""

    capture: ProbeCapture
    standing: StandingPartitions
    used: list[str]
    left_out: list[tuple[str, str]]
    doubts: list[str]


def capture_partition_probe(
    source: Path | Sequence[Path] | int,
    *,
    setup: Setup,
    assembly: Path,
    out: Path,
    albedo: KernelAlbedo,
    most: int = FRAMES_MOST,
    more: bool = False,
    warn: Tell = print,
) -> PartitionCaptureResult:
    """shading.json, capture.json and a copy of assembly.json in ``out``.

    With ``more``, the shading that is there is gone on with: a cell's is replaced where a new
    picture shows its face larger.

    Raises
    ------
    InputError
        No picture shows the board and a face, or a file cannot be used; nothing is written.
    """
    before = out / "shading.json"
    require_capture(before, more=more, most=most)
    standing = load_standing_partitions(assembly)
    standing.require_board(setup.board.size_mm)
    start = load_capture(before) if more else ProbeCapture.blank(standing.design, albedo.rgb)
    start.require_design(standing.design)
    if not np.array_equal(start.albedo, albedo.rgb):
        raise InputError(f"{before} was captured with another --albedo: give the same")
    with results_folder(out) as folder:
        found = capture_faces(read_frames(source, most=most), standing, setup, start)
        save_capture(folder / "shading.json", found.capture)
        write_json(folder / "assembly.json", describe_standing_partitions(found.standing))
        write_json(folder / "capture.json", describe_partition_capture(found))
    tell_doubts(found.left_out, found.doubts, warn)
    return found


def capture_faces(
    frames: Iterable[Frame], standing: StandingPartitions, setup: Setup, start: ProbeCapture
) -> PartitionCaptureResult:
    """Everything that pictures tell, the board found in each on its own; one at a time."""
    probe = standing.placed()
    capture = SampleCapture(probe, start)
    pictures = BoardPictures(frames, setup)
    for frame, pose in pictures:
        capture.add_photo(frame.image, setup.response, pose, setup.intrinsics)
    pictures.require_some()
    captured = capture.captured()
    if not captured.known.any():
        burnt, small = int(capture.rejected.sum()), int(capture.small.sum())
        if burnt:
            raise InputError(f"all {burnt} faces in view are over-exposed: expose shorter")
        if small:
            raise InputError(f"all {small} faces in view are too small: come closer")
        raise InputError(
            f"no face of the kernel is seen whole in any of {len(pictures.used)} pictures: look "
            "into the cells, and check that the assembly is that of the probe"
        )
    return PartitionCaptureResult(
        capture=captured,
        standing=standing,
        used=pictures.used,
        left_out=pictures.left_out,
        doubts=_doubts(captured, capture.small, probe.normals),
    )


def completed_shading(
    capture: ProbeCapture, standing: StandingPartitions, probe: PartitionProbe, warn: Tell
) -> Float[Tensor, "n 3"]:
    """The shading of all cells, those that are missing from the smoothest light, which is said.

    Raises
    ------
    InputError
        The capture is of another probe, or less than half of the cells are known.
    """
    capture.require_design(standing.design)
    shading = completed(torch.from_numpy(capture.shading), torch.from_numpy(capture.known), probe)
    missing = ~capture.known
    if missing.any():
        named = name_cells(missing, probe.cells.normals.numpy() @ standing.rotation.T)
        warn(
            f"{missing.sum()} of {len(missing)} cells were not captured and get the mean light of "
            f"their neighbours: {named}"
        )
    return shading


def describe_partition_capture(found: PartitionCaptureResult) -> dict[str, object]:
    """In plain numbers."""
    return {
        "cells": len(found.capture.known),
        "captured": int(found.capture.known.sum()),
        "pictures": found.used,
        "left_out": [{"name": name, "reason": reason} for name, reason in found.left_out],
        "doubts": found.doubts,
        "version": __version__,
    }


def summarise_partition_capture(found: PartitionCaptureResult) -> str:
    """One line."""
    known = found.capture.known
    return f"{known.sum()} of {len(known)} cells from {len(found.used)} pictures"


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


def _doubts(
    captured: ProbeCapture,
    small: np.ndarray,
    normals: Float[np.ndarray, "n 3"],
) -> list[str]:
    doubts = []
    n = len(captured.known)
    burnt = captured.saturated & ~captured.known
    small = small & ~burnt & ~captured.known
    unseen = ~(captured.known | burnt | small)
    if unseen.any():
        doubts.append(
            f"{unseen.sum()} of {n} cells are seen in no picture: {name_cells(unseen, normals)}; "
            "add pictures from there with --more"
        )
    if small.any():
        doubts.append(
            f"{small.sum()} cells are below {LEAST_AREA_PX:g} square pixels in every picture: "
            f"{name_cells(small, normals)}; come closer"
        )
    if burnt.any():
        doubts.append(
            f"{burnt.sum()} cells are over-exposed in every picture: "
            f"{name_cells(burnt, normals)}; expose shorter"
        )
    # without any second view, a comparison with NaN is False
    moved = captured.disagreement > MOVED
    if moved.any():
        worst = float(captured.disagreement[moved].max())
        doubts.append(
            f"{moved.sum()} of {n} cells differ between pictures, by up to {worst:.0%}: "
            f"{name_cells(moved, normals)}; the light moved or changed, the exposure was not "
            "fixed, or the probe stands elsewhere than the assembly says"
        )
    return doubts
