"""A film with a voxel model in it, lit by the probe that the film shows, frame by frame."""

from collections.abc import Callable
from pathlib import Path

import torch

from skylight.app.board_pictures import Setup
from skylight.app.live_film import LiveReport, check_film, write_film
from skylight.app.voxel_render import Reconstruction, Stand, reconstruction_for
from skylight.probes.voxel.live import LiveView
from skylight.probes.voxel.model import VoxelModel
from skylight.probes.voxel.placement import load_standing_probe

Tell = Callable[[str], None]


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
    check_film(source, out, most)
    standing = load_standing_probe(assembly)
    standing.require_board(setup.board.size_mm)
    view = LiveView(
        intrinsics=setup.intrinsics,
        board=setup.board,
        response=setup.response,
        probe=standing.placed(),
        model=model,
        to_board=stand.matrix(model, torch.from_numpy(standing.placement.rotation)),
        reconstruction=lambda lightmap: reconstruction_for(lightmap, kind, albedo),
    )
    size = setup.intrinsics.width, setup.intrinsics.height
    report = write_film(source, out, view.show, size=size, most=most)
    tell(report.sentence(out, "slots"))
    return report
