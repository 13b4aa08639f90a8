"""``skylight skies``: simulate skies, or index a folder of captured ones."""

import math
from pathlib import Path
from typing import Literal

import tyro
from tyro.conf import Positional

from skylight._options import who_works
from skylight.errors import InputError

# Parsing must not import torch, so the choices stand here again; a test compares the two.
MapLayout = Literal["auto", "skylatlong", "latlong", "angular", "fisheye"]

skies = tyro.extras.SubcommandApp()


@skies.command(name="simulate")
def simulate_skies(
    days: int,
    out: Path,
    size: str = "32x128",
    interval: float = 80.0,
    first_seed: int = 0,
    lowest_sun: float = -6.0,
    workers: int = 0,
    cluster: str | None = None,
    clear: float | None = None,
    broken: float | None = None,
    overcast: float | None = None,
) -> None:
    """Simulate days of skies as EXR maps with an index; an interrupted run goes on.

    Args:
        days: How many days.
        out: Folder for the maps and index.csv.
        size: Height x width of a map of the upper hemisphere: its width is 4 heights.
        interval: Minutes from one sky to the next; nights are left out.
        first_seed: Seed of the first day; the others follow.
        lowest_sun: Degrees above the horizon where the sun must stand; -6 ends civil twilight.
        workers: Processes that work at the same time; 0 for one per core.
        cluster: A dask scheduler's address, whose workers do it instead.
        clear: Share of clear days. Where any of the three shares is given, those that are not
            are 0, and they are scaled to a sum of 1; by default 0.35, 0.4 and 0.25.
        broken: Share of days with broken clouds.
        overcast: Share of overcast days.
    """
    height = _sky_height(size)
    for name, value in (("days", days), ("interval", interval)):
        if not value > 0 or not math.isfinite(value):
            raise InputError(f"--{name} must be above 0, got {value}")
    if not -6 <= lowest_sun < 90:
        raise InputError(f"--lowest-sun must be from -6 to 90 degrees, got {lowest_sun:g}")
    who = who_works(workers, cluster, out)
    from skylight.skies._index import counts, read_index
    from skylight.skies._simulated import regime_shares, simulate_folder
    from skylight.work._progress import stage_bar, with_time_left

    shares = regime_shares(clear=clear, broken=broken, overcast=overcast)
    with stage_bar() as progress:
        index = simulate_folder(
            out,
            days=days,
            first_seed=first_seed,
            interval_min=interval,
            height=height,
            shares=shares,
            lowest_sun_deg=lowest_sun,
            workers=who,
            progress=with_time_left("day", progress),
        )
    print(f"{index}: {counts(read_index(out))}")


@skies.command(name="index")
def index_skies(
    folder: Positional[Path],
    out: Path | None = None,
    days: Path | None = None,
    layout: MapLayout = "auto",
    field_deg: float = 180.0,
    tolerance: float | None = None,
    all_maps: bool = False,
) -> None:
    """Write an index for a folder of captured skies, and say what was found and refused.

    Maps are .exr or .hdr, in FOLDER or folders within it. Refused are those with a clipped sun,
    with values that are not finite or negative, all black, or too small. Left out are rooms,
    studios and nights, by the column category of an index.csv in FOLDER or by the map itself.
    Days are kept apart in training, validation and test.

    Args:
        folder: Folder of maps.
        out: The index to write; by default index.csv in FOLDER.
        days: CSV with the columns file,day or file,day,time. A map that is not in it has the day
            of its name (20240131_154500 and the like), else that of its header's capture date,
            else a day of its own.
        layout: Of the maps: upper half (skylatlong, width 4 heights) or whole lat-long maps
            (width 2 heights), or squares with the zenith in the middle and equal angles from it
            at equal distances: angular has azimuth 0 at the bottom and +90 degrees on the
            right, fisheye azimuth 0 at the top and +90 on the left. auto goes by the shape and
            takes squares for angular.
        field_deg: Degrees that a square map shows across its inscribed circle.
        tolerance: How far the sets' shares of skies, and of sunny ones, may be from those
            wanted; by default 0.05, or 10 / days where that is more.
        all_maps: Index maps that show no sky above, too.
    """
    from skylight.skies._captures import describe, index_folder
    from skylight.skies._index import counts
    from skylight.work._progress import stage_bar, with_time_left

    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give one with .exr or .hdr maps")
    with stage_bar() as progress:
        index, records, refusals = index_folder(
            folder,
            out=out,
            layout=None if layout == "auto" else layout,
            field_deg=field_deg,
            days=days,
            tolerance=tolerance,
            all_maps=all_maps,
            progress=with_time_left("map", progress),
        )
    for line in describe(records, refusals):
        print(line)
    refused = sum(refusal.is_sky for refusal in refusals)
    left_out = len(refusals) - refused
    print(f"{index}: {counts(records)}, {refused} refused, {left_out} left out")


def _sky_height(size: str) -> int:
    """The height that "HxW" names."""
    height, _, width = size.partition("x")
    if not (height.isdigit() and width.isdigit() and int(width) == 4 * int(height) > 0):
        raise InputError(f"--size must be HEIGHTxWIDTH with a width of 4 heights, got {size!r}")
    return int(height)
