"""``skylight probe``: one command for each kind of light probe, and the ground's albedo."""

from pathlib import Path

import tyro
from tyro.conf import Positional

from skylight._options import take_care
from skylight.probes.mirror_balls._command import merge_exposures
from skylight.probes.panorama._command import stitch_shots
from skylight.probes.partitions._command import Box, partitions
from skylight.probes.voxel._command import voxel

probe = tyro.extras.SubcommandApp()
probe.command(name="merge")(merge_exposures)
probe.command(name="stitch")(stitch_shots)


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
    from skylight.probes._ground_files import ground_albedo

    ground_albedo(photo, out, flat=flat, region=region, response=response, warn=take_care)


probe.command(voxel, name="voxel", help="Voxel shading probes.")
probe.command(partitions, name="partitions", help="Shading probes that part the sphere.")
