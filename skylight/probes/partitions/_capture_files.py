"""The shading of a printed partition probe from photographs or a film, files to files.

Designs of partition probes by name, from files, and for a day's sun path.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight import __version__
from skylight.errors import InputError
from skylight.io._bounded import json_content, write_json
from skylight.io._files import write_png
from skylight.probes._chart import Rectangle
from skylight.probes.cameras._files import (
    MOVED,
    BoardPictures,
    Setup,
    report_warnings,
    require_capture,
)
from skylight.probes.cameras._live import FRAMES_MOST, Frame, read_frames, read_picture
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
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._design_files import place_and_day
from skylight.probes.partitions._kernel_albedo import (
    KernelAlbedo,
    albedo_beside_card,
    albedo_beside_chart,
    save_albedo,
)
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions._picture import draw_cells
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._seeds import ProbeDesign, load_design, save_design
from skylight.probes.partitions._sun_path import path_design, sun_path
from skylight.probes.partitions.printed._assembly import PartitionAssembly, load_partition_assembly
from skylight.sphere._rotation import RigidTransform
from skylight.work._progress import Tell
from skylight.work._resumable import results_folder

_TURNED_DEG = 3.0  # more is no play of sockets
_UNSURE = 0.05  # standard error of an albedo, of itself


@dataclass(frozen=True, kw_only=True)
class PartitionCaptureResult:
    """``warnings`` are sentences for the user, empty when all went well."""

    capture: ProbeCapture
    assembly: PartitionAssembly
    used: list[str]
    left_out: list[tuple[str, str]]
    warnings: list[str]
    alignment: PartitionAlignment


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
    earlier = _earlier(out / "capture.json") if more else {}
    with results_folder(out) as folder:
        found = capture_faces(read_frames(source, most=most), printed, setup, start)
        save_capture(folder / "shading.json", found.capture)
        write_json(folder / "assembly.json", found.assembly.to_json())
        write_json(folder / "capture.json", describe_partition_capture(found, earlier))
    report_warnings(found.left_out, found.warnings, warn)
    return found


def capture_faces(
    frames: Iterable[Frame], assembly: PartitionAssembly, setup: Setup, start: ProbeCapture
) -> PartitionCaptureResult:
    """Everything that pictures tell, the board found in each on its own.

    The outlines of the probe's faces in all of them say where it stands; all pictures are held in
    memory for that.
    """
    placed = assembly.placed()
    aligner = PartitionAligner(assembly, placed, setup.intrinsics)
    seen: list[tuple[Frame, RigidTransform]] = []
    pictures = BoardPictures(frames, setup)
    for frame, pose in pictures:
        aligner.add(frame.image, pose)
        seen.append((frame, pose))
    pictures.require_some()
    alignment = aligner.alignment()
    if not alignment.shown:
        raise InputError(
            f"no probe where the assembly says, in any of {len(seen)} pictures: the edges of its "
            "white faces are not there; stand it on the board, and check that the assembly is its"
        )
    if alignment.rejection is None:
        motion = alignment.fit.motion.about(assembly.board_from_probe.translation)
        # not built anew: pins are where they were printed
        placed = placed.moved(motion)
        assembly = replace(assembly, board_from_probe=motion @ assembly.board_from_probe)
    capture = SampleCapture(placed, start)
    for (frame, pose), shown in zip(seen, alignment.shown_in.tolist(), strict=True):
        if shown:
            capture.add_photo(frame.image, setup.response, pose, setup.intrinsics)
        else:
            pictures.used.remove(frame.name)
            pictures.left_out.append((frame.name, "no probe where the others show it"))
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


def describe_partition_capture(
    found: PartitionCaptureResult, earlier: Mapping[str, object]
) -> dict[str, object]:
    """In plain numbers, after the pictures of an ``earlier`` description that it adds to."""
    left_out = [{"name": name, "reason": reason} for name, reason in found.left_out]
    alignment = found.alignment
    return {
        "cells": len(found.capture.known),
        "captured": int(found.capture.known.sum()),
        "pictures": [*_listed(earlier, "pictures"), *found.used],
        "left_out": [*_listed(earlier, "left_out"), *left_out],
        "alignment": {
            "turn_deg": alignment.fit.turn_deg.tolist(),
            "shift_mm": alignment.fit.shift_mm.tolist(),
            "share_of_outline": alignment.fit.share,
            "share_unmoved": alignment.unmoved.share,
            "same_every_deg": alignment.same_every_deg,
            "applied": alignment.rejection is None,
        },
        "warnings": found.warnings,
        "version": __version__,
    }


def summarise_partition_capture(found: PartitionCaptureResult) -> str:
    """What was captured, and where the probe stood."""
    known, alignment = found.capture.known, found.alignment
    told = f"{known.sum()} of {len(known)} cells from {len(found.used)} pictures"
    if alignment.rejection is not None:
        return told
    fit, every = alignment.fit, alignment.same_every_deg
    alike = f" (or a multiple of {every:g} more: its edges are alike)" if every < 360 else ""
    return (
        f"{told}; the probe stands {fit.motion.angle_deg:.1f} degrees{alike} and "
        f"{fit.motion.translation.norm():.1f} mm off its place; allowed for"
    )


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


def _earlier(path: Path) -> dict[str, object]:
    """The report of the earlier capture; empty where there is none."""
    try:
        content = json_content(path) if path.exists() else {}
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path} ({error}): take it away or mend it") from error
    return content if isinstance(content, dict) else {}


def _listed(content: Mapping[str, object], key: str) -> list[object]:
    found = content.get(key)
    return found if isinstance(found, list) else []


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


_SIZE_MOST = 4000

PlaceAndDay = tuple[float, float, str]


def find_design(told: str, sun: PlaceAndDay | None = None, path_cells: int = 12) -> ProbeDesign:
    """The design of that name or in that file, divided along the sun's path where one is given.

    ``sun`` is the latitude and longitude in degrees, and the day as YYYY-MM-DD.
    """
    base = load_design(told) if told.lower().endswith(".json") else named_design(told)
    if sun is None:
        return base
    place, when = place_and_day(*sun)
    path = sun_path(place, when)
    name = f"{base.name}-sun-{path_cells}-{when.isoformat()}"
    return path_design(name, base, path_cells, path)


def describe_designs() -> str:
    """The named designs, one a line."""
    return "\n".join(f"{name:<20}{named_design(name).count:>4} cells" for name in design_names())


def write_cells(design: ProbeDesign, out: Path | None, save: Path | None, *, size: int) -> str:
    """What there is to say of a design's cells; with their picture and file, where asked for."""
    if out is not None and out.suffix.lower() != ".png":
        raise InputError(f"{out}: the picture is written as .png; choose another name")
    if save is not None and save.suffix.lower() != ".json":
        raise InputError(f"{save}: designs are written as .json; choose another name")
    if not 16 <= size <= _SIZE_MOST:
        raise InputError(f"the picture must be 16 to {_SIZE_MOST} pixels high, got {size}")
    cells = Cells.of(design)
    if out is not None:
        write_png(out, draw_cells(cells, size=size))
    if save is not None:
        save_design(save, design)
    return describe_cells(cells)


def describe_cells(cells: Cells) -> str:
    """A table: where each cell looks, and how large it is."""
    stand = ", to be placed with -Z north and +X east" if cells.design.oriented else ""
    lines = [
        f"{cells.design.name}: {cells.count} cells{stand}",
        "cell     x      y      z      sr  facing/pi",
    ]
    # rounded first, so that no -0.00 is printed
    rounded = (cells.normals * 100).round() / 100 + 0.0
    share = (cells.facing / math.pi).tolist()
    table = zip(rounded.tolist(), cells.solid_angles.tolist(), share, strict=True)
    lines += [
        f"{i:>4} {x:6.2f} {y:6.2f} {z:6.2f} {sr:7.3f} {seen:10.3f}"
        for i, ((x, y, z), sr, seen) in enumerate(table)
    ]
    return "\n".join(lines)
