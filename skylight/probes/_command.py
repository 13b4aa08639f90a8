"""``skylight probe``: one command for each kind of light probe, and the ground's albedo."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import tyro
from tyro.conf import Positional

from skylight._names import MergedFrom
from skylight._options import take_care
from skylight.probes.partitions._command import Box, partitions
from skylight.probes.voxel._command import voxel
from skylight.work._progress import StageProgress, Tell, stage_bar

probe = tyro.extras.SubcommandApp()


@probe.command(name="merge")
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

    options = BallOptions(
        circles=(ball, second_ball), fov_deg=fov_deg, turn_deg=turn_deg, reflectivity=reflectivity
    )
    with _bar_then_warnings() as (progress, warn):
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
            warn=warn,
        )


@probe.command(name="stitch")
def stitch_shots(
    shots: Positional[tuple[Path, ...]],
    out: Path = Path("probe"),
    bracket: int | None = None,
    times: str | None = None,
    response: str = "auto",
    focal_length_px: float | None = None,
    turns: Path | None = None,
    height: int = 256,
) -> None:
    """Stitch an HDR light probe from the bracketed shots of a camera that turns about its lens.

    Neighbouring shots overlap by a third or so; aperture, ISO, white balance and focus are fixed.
    Writes probe.exr, probe.hdr, probe.json and report.png. The map is upright, and its centre is
    where the first shot looked.

    Args:
        shots: A folder with a folder for each direction, a folder with all pictures in the order
            in which they were taken, or the pictures: JPEG, PNG, TIFF, RAW, or .exr and .hdr that
            were merged already.
        out: Folder for the results.
        bracket: Exposures of each direction; by default as many as there are different times.
        times: Exposure times of one direction, such as 1/1000,1/60,1/4, the same for all; by
            default those in the files' EXIF data.
        response: How 8-bit codes encode light: auto, srgb, recover (from the first direction), or
            a file of `skylight camera response`.
        focal_length_px: About the focal length in pixels of the pictures; by default by their EXIF
            data, or from the turns.
        turns: Table (CSV) of azimuth_deg and elevation_deg, a row for each direction: where the
            camera looked, to two degrees or so, for skies and walls that show nothing to match.
        height: Rows of the map.
    """
    from skylight.probes.panorama._files import stitch_probe

    with _bar_then_warnings() as (progress, warn):
        stitch_probe(
            shots,
            out,
            bracket=bracket,
            times=times,
            response=response,
            focal_length_px=focal_length_px,
            turns=turns,
            height=height,
            progress=progress,
            warn=warn,
        )


@contextmanager
def _bar_then_warnings() -> Iterator[tuple[StageProgress, Tell]]:
    """Progress on a bar, and a function for warnings, which are printed when the bar has gone."""
    warnings: list[str] = []
    with stage_bar() as progress:
        yield progress, warnings.append
    for line in warnings:
        take_care(line)


@probe.command(name="ground")
def ground(
    photo: Positional[Path],
    flat: Path | None = None,
    region: Box | None = None,
    response: Path | None = None,
    out: Path = Path("ground.json"),
) -> None:
    """Measure the ground's albedo from a photo of it with a ColorChecker lying on it.

    The light on both must be the same, and even; RAW is best. `skylight estimate` takes the file
    that is written as --ground-albedo.

    Args:
        photo: The photo, from above: the chart, and much ground of one kind.
        flat: A photo of something even (an overcast sky, a white wall out of focus) by the same
            lens, aperture and focal length, to undo its vignetting.
        region: Rectangle of the ground: x, y of the upper left corner, width, height in pixels; by
            default all that is not chart.
        response: The camera's response, as `skylight camera response` wrote it; otherwise sRGB.
        out: File to write.
    """
    from skylight.probes._chart import ground_albedo

    ground_albedo(photo, out, flat=flat, region=region, response=response, warn=take_care)


probe.command(voxel, name="voxel", help="Voxel shading probes.")
probe.command(partitions, name="partitions", help="Shading probes that part the sphere.")
