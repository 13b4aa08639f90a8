"""Video with a voxel model lit by the voxel probe that it shows."""

from pathlib import Path

from skylight.app.cameras.board_pictures import Setup
from skylight.app.cameras.live_film import LiveReport, check_film, write_film
from skylight.app.probes.voxel.render import Reconstruction, VoxelPlacement, reconstruction_for
from skylight.probes.voxel.model import VoxelModel
from skylight.probes.voxel.printed.assembly import PlacedProbe, load_voxel_assembly
from skylight.probes.voxel.relight.live import LiveView
from skylight.work.progress import Tell


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
    """Write ``out`` (.mp4) with the model drawn into each frame of a video or webcam.

    Ctrl-C ends a webcam's film, which is kept.

    Raises
    ------
    InputError
        The source or another file cannot be used, or no frame shows the board.
    """
    check_film(source, out, most)
    printed = load_voxel_assembly(assembly)
    printed.require_board(setup.board.size_mm)
    view = LiveView(
        intrinsics=setup.intrinsics,
        board=setup.board,
        response=setup.response,
        probe=PlacedProbe(printed),
        model=model,
        to_board=placement.matrix(model, printed.board_from_probe.rotation),
        reconstruction=lambda lightmap: reconstruction_for(lightmap, kind, albedo),
    )
    size = setup.intrinsics.width, setup.intrinsics.height
    report = write_film(source, out, view.show, size=size, most=most)
    tell(report.sentence(out, "slots"))
    return report
