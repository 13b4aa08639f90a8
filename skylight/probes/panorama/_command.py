"""``skylight probe stitch``."""

from pathlib import Path

from tyro.conf import Positional

from skylight._options import take_care


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
    from skylight.work._progress import stage_bar

    doubts: list[str] = []
    with stage_bar() as progress:
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
            warn=doubts.append,
        )
    for line in doubts:
        take_care(line)
