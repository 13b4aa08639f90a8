"""A film with a virtual scene in it, lit by the partition probe that the film shows."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from skylight.app.board_pictures import Setup
from skylight.app.live_film import LiveReport, check_film, write_film
from skylight.app.partition_relight import VirtualScene, read_probe
from skylight.probes.partitions.live import PartitionLiveView, RunningShading

Tell = Callable[[str], None]


def live_scene(
    source: Path | int,
    out: Path,
    *,
    scene: VirtualScene,
    setup: Setup,
    assembly: Path,
    capture: Path | None = None,
    albedo: Float[np.ndarray, "3"] | None = None,
    most: int | None = None,
    tell: Tell = print,
    warn: Tell = print,
) -> LiveReport:
    """Write ``out`` (.mp4) with the scene drawn into each frame of a video or webcam.

    ``capture`` is what is known of the light at first; without it, the scene appears once half of
    the cells were seen, and ``albedo`` is the kernel's. Ctrl-C ends a webcam's film, which is kept.

    Raises
    ------
    InputError
        The source or another file cannot be used, or no frame shows the board.
    """
    check_film(source, out, most)
    scene.require(out)
    standing, probe, captured = read_probe(assembly, capture, albedo)
    standing.require_board(setup.board.size_mm)
    placed = standing.placed()
    on_board = scene.beside(placed, probe.cells, torch.from_numpy(standing.rotation), warn)
    view = PartitionLiveView(
        intrinsics=setup.intrinsics,
        board=setup.board,
        response=setup.response,
        placed=placed,
        probe=probe,
        scene=on_board,
        shading=RunningShading(captured.shading, captured.known),
    )
    size = setup.intrinsics.width, setup.intrinsics.height
    report = write_film(source, out, view.show, size=size, most=most)
    tell(report.sentence(out, f"of {probe.cells.count} cells"))
    return report
