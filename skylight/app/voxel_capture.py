"""The shading of a printed voxel probe from photographs or a film, files to files."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

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
from skylight.imaging.files import write_json, write_png
from skylight.probes.capture.frames import FRAMES_MOST, Frame, read_frames
from skylight.probes.capture.pose import Pose
from skylight.probes.voxel.alignment import Aligner, Alignment
from skylight.probes.voxel.capture import LightmapCapture
from skylight.probes.voxel.faces import OCCLUDERS, ORIENTATIONS
from skylight.probes.voxel.lightmap import Lightmap, load_lightmap
from skylight.probes.voxel.placement import (
    StandingProbe,
    describe_standing_probe,
    load_standing_probe,
)
from skylight.probes.voxel.reconstruct import first_slot, ranks


@dataclass(frozen=True, kw_only=True)
class CaptureResult:
    """``doubts`` are sentences for the user, empty when all went well."""

    lightmap: Lightmap
    standing: StandingProbe
    used: list[str]
    left_out: list[tuple[str, str]]
    disagreement: float | None
    alignment: Alignment | None
    aligned: bool
    doubts: list[str]


def capture_voxel_probe(
    source: Path | Sequence[Path] | int,
    *,
    setup: Setup,
    assembly: Path,
    out: Path,
    most: int = FRAMES_MOST,
    more: bool = False,
    tell: Tell = print,
    warn: Tell = print,
) -> CaptureResult:
    """lightmap.npz, lightmap.png, capture.json and assembly.json in ``out``.

    With ``more``, the lightmap that is there is gone on with: a slot is replaced where a new
    picture shows it larger. assembly.json has the probe where it was found to stand.

    Raises
    ------
    InputError
        No picture shows the board and the probe, or a file cannot be used; nothing is written.
    """
    before = out / "lightmap.npz"
    require_capture(before, more=more, most=most)
    standing = load_standing_probe(assembly)
    standing.require_board(setup.board.size_mm)
    start = load_lightmap(before) if more else None
    with results_folder(out) as folder:
        found = capture_frames(read_frames(source, most=most), standing, setup, start)
        found.lightmap.save(folder / "lightmap.npz")
        write_png(folder / "lightmap.png", found.lightmap.png())
        write_json(folder / "assembly.json", describe_standing_probe(found.standing))
        write_json(folder / "capture.json", describe_capture(found))
    tell_doubts(found.left_out, found.doubts, warn)
    slots = int(found.lightmap.known.sum())
    tell(f"{out}: {slots} of 192 slots from {len(found.used)} pictures")
    if found.alignment is not None and found.aligned:
        turn, shift = (
            float(np.linalg.norm(v)) for v in (found.alignment.turn_deg, found.alignment.shift_mm)
        )
        tell(f"the probe stands {turn:.1f} degrees and {shift:.1f} mm off its place; allowed for")
    return found


def capture_frames(
    frames: Iterable[Frame], standing: StandingProbe, setup: Setup, start: Lightmap | None = None
) -> CaptureResult:
    """Everything that pictures tell, the board found in each on its own.

    The probe's own edges in all of them say where it stands, if they agree; all pictures are held
    in memory for that.
    """
    seen: list[tuple[Frame, Pose]] = []
    pictures = BoardPictures(frames, setup)
    aligner = Aligner(standing.placed(), setup.intrinsics)
    for frame, pose in pictures:
        aligner.add(frame.image, pose)
        seen.append((frame, pose))
    pictures.require_some()
    alignment = aligner.alignment()
    aligned = alignment is not None and alignment.trusted(standing.placement.voxel_mm)
    if alignment is not None and aligned:
        placement = alignment.applied(standing.placement, aligner.middle_mm)
        standing = replace(standing, placement=placement)
    capture = LightmapCapture(standing.placed(), start)
    for frame, pose in seen:
        capture.add_photo(frame.image, setup.response, pose, setup.intrinsics)
    lightmap = capture.lightmap()
    if not bool(lightmap.known.any()):
        burnt = int(capture.rejected.sum())
        raise InputError(
            f"all {burnt} faces in view are over-exposed: expose shorter"
            if burnt
            else f"no face of the probe is whole in any of {len(seen)} pictures: step back, and "
            "check that the assembly is that of the probe"
        )
    disagreement = float(np.median(capture.disagreements)) if capture.disagreements else None
    return CaptureResult(
        lightmap=lightmap,
        standing=standing,
        used=pictures.used,
        left_out=pictures.left_out,
        disagreement=disagreement,
        alignment=alignment,
        aligned=aligned,
        doubts=_doubts(capture, lightmap, disagreement, alignment),
    )


def describe_capture(found: CaptureResult) -> dict[str, object]:
    """In plain numbers."""
    return {
        "slots": int(found.lightmap.known.sum()),
        "pictures": found.used,
        "left_out": [{"name": name, "reason": reason} for name, reason in found.left_out],
        "disagreement": found.disagreement,
        "alignment": None
        if found.alignment is None
        else {
            **describe_alignment(found.alignment),
            "applied": found.aligned,
        },
        "doubts": found.doubts,
        "coverage": found.lightmap.coverage.tolist(),
        "pixels_per_texel": found.lightmap.confidence.tolist(),
        "version": __version__,
    }


def describe_alignment(alignment: Alignment) -> dict[str, object]:
    """How the probe stands otherwise than it was meant to."""
    return {
        "turn_deg": alignment.turn_deg.tolist(),
        "shift_mm": alignment.shift_mm.tolist(),
        "turn_spread_deg": alignment.turn_spread_deg,
        "shift_spread_mm": alignment.shift_spread_mm,
        "pictures": alignment.pictures,
    }


def _doubts(
    capture: LightmapCapture,
    lightmap: Lightmap,
    disagreement: float | None,
    alignment: Alignment | None,
) -> list[str]:
    doubts = []
    if alignment is None:
        doubts.append(
            "the probe's edges are clear in too few pictures to tell where it stands: the "
            "assembly's word was taken for it"
        )
    elif not alignment.agrees:
        doubts.append(
            "pictures disagree about where the probe stands (by "
            f"{alignment.turn_spread_deg:.1f} degrees and {alignment.shift_spread_mm:.1f} mm): did "
            "it move? The assembly's word was taken for it"
        )
    elif not alignment.plausible(capture.probe.placement.voxel_mm):
        doubts.append(
            "by its edges the probe stands far from where the assembly says "
            f"({np.linalg.norm(alignment.turn_deg):.0f} degrees, "
            f"{np.linalg.norm(alignment.shift_mm):.0f} mm), further than they can be told from "
            "one another: turn its notch to the base's, and check the files"
        )
    if disagreement is not None and disagreement > MOVED:
        doubts.append(
            f"faces seen twice differ by {disagreement:.0%} (median): the light moved or changed, "
            "the exposure was not fixed, or the probe stands elsewhere than the assembly says"
        )
    burnt = torch.from_numpy(capture.rejected)
    if bool(burnt.any()):
        doubts.append(
            f"{int(burnt.sum())} slots are over-exposed in every picture, the first "
            f"{first_slot(burnt)}: expose shorter"
        )
    slots, needed = lightmap.known.sum(1).tolist(), len(OCCLUDERS)
    for name, count, rank in zip(ORIENTATIONS, slots, ranks(lightmap.known).tolist(), strict=True):
        if rank < needed:
            doubts.append(
                f"orientation {name} has {count} captured slots of rank {rank}, {needed} "
                "are needed: walk round the probe, or use a probe that encodes more"
            )
    return doubts
