"""``skylight probe merge``."""

from pathlib import Path

from tyro.conf import Positional

from skylight._names import MergedFrom
from skylight._options import take_care


def merge_exposures(
    photos: Positional[tuple[Path, ...]],
    out: Path = Path("probe"),
    kind: MergedFrom = "ball",
    second: tuple[Path, ...] = (),
    times: str | None = None,
    response: str = "auto",
    ball: tuple[float, float, float] | None = None,
    second_ball: tuple[float, float, float] | None = None,
    fov_deg: float | None = None,
    turn_deg: float = 90.0,
    reflectivity: float = 1.0,
    height: int = 256,
) -> None:
    """Make an HDR light probe from exposures of a mirror ball, or of a 360-degree camera.

    Keep the camera still, vary the exposure time alone, from so short that the sun or the lamps
    are not white to so long that shadows show. Writes probe.exr, probe.hdr, probe.json and
    report.png. The map is in the frame of `skylight estimate` for the (first) camera: its centre
    shows where that camera looked, which is behind the ball.

    Args:
        photos: Two exposures or more (JPEG, PNG or TIFF of 8 bits; linear .exr or .hdr), or one
            .exr or .hdr that was merged already.
        out: Folder for the results.
        kind: What they show: a mirror ball, or (360) a whole lat-long picture.
        second: The same of a ball seen from elsewhere, to remove the camera and what is hidden.
        times: Exposure times in their order, such as 1/1000,1/250,1/60, those of the second view
            after those of the first where they differ; by default those in the files' EXIF data.
        response: How codes encode light: auto, srgb, recover (from the exposures), or a file of
            `skylight camera response`.
        ball: Middle (right, down) and radius of the ball in pixels; by default searched for.
        second_ball: The same in the second view.
        fov_deg: Vertical field of view of the uncropped pictures; by default by their EXIF data.
        turn_deg: How far round the ball the second view was taken, about; made exact by matching.
        reflectivity: Share of light that the ball throws back.
        height: Rows of the map.
    """
    from skylight.probes.mirror_balls._files import merge_probe
    from skylight.probes.mirror_balls._merged import BallOptions
    from skylight.work._progress import stage_bar

    options = BallOptions(
        circles=(ball, second_ball), fov_deg=fov_deg, turn_deg=turn_deg, reflectivity=reflectivity
    )
    warnings: list[str] = []
    with stage_bar() as progress:
        merge_probe(
            photos,
            out,
            kind=kind,
            second=second,
            times=times,
            response=response,
            ball=options,
            height=height,
            progress=progress,
            warn=warnings.append,
        )
    for line in warnings:
        take_care(line)
