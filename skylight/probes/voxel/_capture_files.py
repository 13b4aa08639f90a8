"""The shading of a printed voxel probe from photographs, and films lit by it; files to files."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.io._files import write_png
from skylight.probes._capture import CaptureResult, PosedFrames, place_found, write_capture
from skylight.probes.cameras._files import MOVED, Setup, require_capture
from skylight.probes.cameras._live import FRAMES_MOST, Frame, LiveReport, check_film
from skylight.probes.voxel._assembly import PlacedProbe, VoxelAssembly, load_voxel_assembly
from skylight.probes.voxel._captured import Aligner, Alignment, LightmapCapture
from skylight.probes.voxel._lightmap import Lightmap, load_lightmap
from skylight.probes.voxel._model import OCCLUDERS, ORIENTATIONS, VoxelModel
from skylight.probes.voxel._reconstruct import first_slot, ranks
from skylight.probes.voxel._relight import VoxelLiveView
from skylight.probes.voxel._render_files import Reconstruction, VoxelPlacement, reconstruction_for
from skylight.work._progress import Tell


@dataclass(frozen=True, kw_only=True)
class VoxelCaptureResult(CaptureResult):
    """The lightmap that pictures told, and how the probe stood.

    ``disagreement`` is the median relative difference of faces seen again, None without any.
    """

    lightmap: Lightmap
    assembly: VoxelAssembly
    disagreement: float | None
    alignment: Alignment | None
    aligned: bool

    def save(self, folder: Path) -> None:
        self.lightmap.save(folder / "lightmap.npz")
        write_png(folder / "lightmap.png", self.lightmap.png())
        write_json(folder / "assembly.json", self.assembly.to_json())

    def describe(self) -> dict[str, object]:
        alignment = self.alignment
        return {
            "slots": int(self.lightmap.known.sum()),
            "disagreement": self.disagreement,
            "alignment": None
            if alignment is None
            else {**alignment.describe(), "applied": self.aligned},
            "coverage": self.lightmap.coverage.tolist(),
            "pixels_per_texel": self.lightmap.confidence.tolist(),
        }

    def summary(self) -> str:
        told = f"{int(self.lightmap.known.sum())} of 192 slots from {len(self.used)} pictures"
        if self.alignment is None or not self.aligned:
            return told
        turn, shift = (
            np.linalg.norm(v) for v in (self.alignment.turn_deg, self.alignment.shift_mm)
        )
        return f"{told}; {place_found(float(turn), float(shift))}"


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
) -> VoxelCaptureResult:
    """lightmap.npz, lightmap.png, capture.json and assembly.json in ``out``.

    ``more`` adds to an earlier capture: a slot is replaced where a new picture shows it larger.
    assembly.json has the probe where it was found to stand.

    Raises
    ------
    InputError
        No picture shows the board and the probe, or a file cannot be used; nothing is written.
    """
    before = out / "lightmap.npz"
    require_capture(before, more=more, most=most)
    printed = load_voxel_assembly(assembly)
    printed.require_board(setup.board.size_mm)
    start = load_lightmap(before) if more else None
    return write_capture(
        source,
        out,
        lambda frames: capture_frames(frames, printed, setup, start),
        most=most,
        more=more,
        tell=tell,
        warn=warn,
    )


def capture_frames(
    frames: Iterable[Frame], assembly: VoxelAssembly, setup: Setup, start: Lightmap | None = None
) -> VoxelCaptureResult:
    """Everything that pictures tell; the probe's own edges in all say where it stands."""
    pictures = PosedFrames.of(frames, setup)
    aligner = Aligner(PlacedProbe(assembly), setup.intrinsics)
    for frame, pose in pictures.seen:
        aligner.add(frame.image, pose)
    alignment = aligner.alignment()
    aligned = alignment is not None and alignment.trusted(assembly.voxel_mm)
    if alignment is not None and aligned:
        assembly = alignment.applied(assembly)
    capture = LightmapCapture(PlacedProbe(assembly), start)
    for frame, pose in pictures.seen:
        capture.add_photo(frame.image, setup.response, pose, setup.intrinsics)
    lightmap = capture.lightmap()
    if not bool(lightmap.known.any()):
        burnt = int(capture.rejected.sum())
        raise InputError(
            f"all {burnt} faces in view are over-exposed: expose shorter"
            if burnt
            else f"no face of the probe is whole in any of {len(pictures.seen)} pictures: step "
            "back, and check that the assembly is that of the probe"
        )
    disagreement = float(np.median(capture.disagreements)) if capture.disagreements else None
    return VoxelCaptureResult(
        lightmap=lightmap,
        assembly=assembly,
        used=pictures.used,
        left_out=pictures.left_out,
        disagreement=disagreement,
        alignment=alignment,
        aligned=aligned,
        warnings=_capture_warnings(capture, lightmap, disagreement, alignment),
    )


def _capture_warnings(
    capture: LightmapCapture,
    lightmap: Lightmap,
    disagreement: float | None,
    alignment: Alignment | None,
) -> list[str]:
    warnings = []
    if alignment is None:
        warnings.append(
            "the probe's edges are clear in too few pictures to tell where it stands: the "
            "assembly's pose is used"
        )
    elif not alignment.agrees:
        warnings.append(
            "pictures disagree about where the probe stands (by "
            f"{alignment.turn_spread_deg:.1f} degrees and {alignment.shift_spread_mm:.1f} mm): did "
            "it move? The assembly's pose is used"
        )
    elif not alignment.plausible(capture.probe.assembly.voxel_mm):
        warnings.append(
            "by its edges the probe stands far from where the assembly says "
            f"({np.linalg.norm(alignment.turn_deg):.0f} degrees, "
            f"{np.linalg.norm(alignment.shift_mm):.0f} mm), further than they can be told from "
            "one another: turn its notch to the base's, and check the files"
        )
    if disagreement is not None and disagreement > MOVED:
        warnings.append(
            f"faces seen twice differ by {disagreement:.0%} (median): the light moved or changed, "
            "the exposure was not fixed, or the probe stands elsewhere than the assembly says"
        )
    burnt = capture.rejected
    if bool(burnt.any()):
        warnings.append(
            f"{int(burnt.sum())} slots are over-exposed in every picture, the first "
            f"{first_slot(burnt)}: expose shorter"
        )
    slots, needed = lightmap.known.sum(1).tolist(), len(OCCLUDERS)
    for name, count, rank in zip(ORIENTATIONS, slots, ranks(lightmap.known).tolist(), strict=True):
        if rank < needed:
            warnings.append(
                f"orientation {name} has {count} captured slots of rank {rank}, {needed} "
                "are needed: walk round the probe, or use a probe that encodes more"
            )
    return warnings


def live_film(
    source: Path | int,
    out: Path,
    *,
    setup: Setup,
    assembly: Path,
    model: VoxelModel,
    placement: VoxelPlacement,
    kind: Reconstruction = "direct",
    albedo: float = 0.8,
    most: int | None = None,
    tell: Tell = print,
) -> LiveReport:
    """Write ``out`` (.mp4, .mkv) with the model drawn into each frame of a video or webcam.

    Ctrl-C ends a webcam's film, which is kept.
    """
    check_film(source, out, most)
    printed = load_voxel_assembly(assembly)
    printed.require_board(setup.board.size_mm)
    view = VoxelLiveView(
        setup,
        probe=PlacedProbe(printed),
        model=model,
        to_board=placement.matrix(model, printed.board_from_probe.rotation),
        reconstruction=lambda lightmap: reconstruction_for(lightmap, kind, albedo),
    )
    return view.write(source, out, most=most, tell=tell)
