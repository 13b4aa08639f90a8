"""A film with a voxel model in it, lit by the probe that the film shows, frame by frame."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
import torch

from skylight.app.voxel_capture import Setup
from skylight.app.voxel_render import Reconstruction, Stand, reconstruction_for
from skylight.errors import InputError, OutputError
from skylight.imaging.atomic import atomic_path
from skylight.probes.capture.frames import film, film_rate
from skylight.probes.voxel.live import STAGES, LiveView
from skylight.probes.voxel.model import VoxelModel
from skylight.probes.voxel.placement import load_standing_probe

Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class LiveReport:
    """Median milliseconds of each stage over the frames that reached it, and of whole frames.

    ``frames_per_s`` counts everything between two frames but reading and writing films.
    """

    frames: int
    tracked: int
    slots: int
    stage_ms: dict[str, float]
    frame_ms: float

    @property
    def frames_per_s(self) -> float:
        return 1000 / self.frame_ms


def live_film(
    source: Path | int,
    out: Path,
    *,
    setup: Setup,
    assembly: Path,
    model: VoxelModel,
    stand: Stand,
    kind: Reconstruction = "direct",
    albedo: float = 0.8,
    most: int | None = None,
    tell: Tell = print,
) -> LiveReport:
    """Write ``out`` (.mp4) with the model drawn into each frame of a video or webcam.

    Ctrl-C ends a webcam's film, which is kept.

    Raises
    ------
    InputError
        The source or another file cannot be used, or no frame shows the board.
    """
    if out.suffix.lower() != ".mp4":
        raise InputError(f"{out}: films are written as .mp4; choose another name")
    if most is not None and most < 1:
        raise InputError(f"at least 1 frame is needed, got {most}")
    standing = load_standing_probe(assembly)
    standing.require_board(setup.board.size_mm)
    rate = film_rate(source)
    view = LiveView(
        intrinsics=setup.intrinsics,
        board=setup.board,
        response=setup.response,
        probe=standing.placed(),
        model=model,
        to_board=stand.matrix(model, torch.from_numpy(standing.placement.rotation)),
        reconstruction=lambda lightmap: reconstruction_for(lightmap, kind, albedo),
    )
    times: dict[str, list[float]] = {stage: [] for stage in STAGES}
    whole: list[float] = []
    tracked = slots = 0
    with atomic_path(out) as temporary:
        made = _writer(temporary, rate, setup.intrinsics.width, setup.intrinsics.height)
        started, written = perf_counter(), 0
        try:
            for shot in film(source):
                begun = perf_counter()
                frame = view.show(shot.image)
                whole.append(perf_counter() - begun)
                # a webcam's frames last as long as they took
                late = round((perf_counter() - started) * rate) - written
                for _ in range(max(1, late) if isinstance(source, int) else 1):
                    made.write(cv2.cvtColor(frame.picture, cv2.COLOR_RGB2BGR))
                    written += 1
                tracked, slots = tracked + frame.tracked, frame.slots
                for stage, seconds in frame.seconds.items():
                    times[stage].append(seconds)
                if most is not None and len(whole) >= most:
                    break
        except KeyboardInterrupt:
            if isinstance(source, Path) or not whole:
                raise
        finally:
            made.release()
        if not tracked:
            raise InputError(
                f"none of {len(whole)} frames shows the marker board: nothing was drawn"
            )
    report = LiveReport(
        frames=len(whole),
        tracked=tracked,
        slots=slots,
        stage_ms={stage: 1000 * float(np.median(t)) for stage, t in times.items() if t},
        frame_ms=1000 * float(np.median(whole)),
    )
    stages = ", ".join(f"{stage} {ms:.1f}" for stage, ms in report.stage_ms.items())
    tell(
        f"{out}: {report.frames} frames, {report.tracked} tracked, {report.slots} slots; "
        f"{report.frames_per_s:.0f} frames/s (ms: {stages})"
    )
    return report


def _writer(path: Path, rate: float, width: int, height: int) -> cv2.VideoWriter:
    code = cv2.VideoWriter.fourcc(*"mp4v")
    made = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, rate, (width, height))
    if not made.isOpened():
        raise OutputError(f"cannot write a film to {path.parent}: choose another folder")
    return made
