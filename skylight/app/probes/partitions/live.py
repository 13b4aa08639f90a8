"""Video with a virtual scene lit by the partition probe that it shows."""

import math
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from skylight.app.cameras.board_pictures import Setup
from skylight.app.cameras.live_film import LiveReport, check_film, write_film
from skylight.app.probes.partitions.relight import VirtualScene, read_probe
from skylight.errors import InputError
from skylight.imaging.film import film_rate
from skylight.probes.partitions.relight.live import PartitionLiveView, RunningShading
from skylight.work.progress import Tell


def live_scene(
    source: Path | int,
    out: Path,
    *,
    scene: VirtualScene,
    setup: Setup,
    assembly: Path,
    capture: Path | None = None,
    albedo: Float[Tensor, "3"] | None = None,
    turn_deg_per_s: float = 0.0,
    most: int | None = None,
    tell: Tell = print,
    warn: Tell = print,
) -> LiveReport:
    """Write ``out`` (.mp4) with the scene drawn into each frame of a video or webcam.

    ``capture`` is what is known of the light at first; without it, the scene appears once half of
    the cells were seen, and ``albedo`` is the kernel's. A scene of several angles turns, in the
    film's own time, counter-clockwise seen from above; a webcam's frames are 30 a second. Ctrl-C
    ends a webcam's film, which is kept.

    Raises
    ------
    InputError
        The source or another file cannot be used, or no frame shows the board.
    """
    check_film(source, out, most)
    if not math.isfinite(turn_deg_per_s):
        raise InputError(f"a scene turns by a finite number of degrees, got {turn_deg_per_s}")
    scene.require(out)
    printed, probe, captured = read_probe(assembly, capture, albedo)
    printed.require_board(setup.board.size_mm)
    placed = printed.placed()
    on_board = scene.beside(placed, probe.cells, printed.board_from_probe.rotation, warn)
    view = PartitionLiveView(
        intrinsics=setup.intrinsics,
        board=setup.board,
        response=setup.response,
        placed=placed,
        probe=probe,
        scene=on_board,
        shading=RunningShading(captured.shading, captured.known),
        start_rad=math.radians(scene.placement.turn_deg),
        step_rad=math.radians(turn_deg_per_s) / film_rate(source),
    )
    size = setup.intrinsics.width, setup.intrinsics.height
    report = write_film(source, out, view.show, size=size, most=most)
    tell(report.sentence(out, f"of {probe.cells.count} cells"))
    return report
