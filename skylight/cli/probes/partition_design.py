"""``skylight probe partitions design``."""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from skylight.errors import InputError


def design_partitions(
    lights: Annotated[Path | None, arg(name="for")] = None,
    out: Path = Path("design"),
    category: str | None = None,
    lat: float | None = None,
    lon: float | None = None,
    date: str | None = None,
    weathers: int = 12,
    cells: int = 14,
    name: str | None = None,
    held_out: float = 0.5,
    width_deg: float | None = None,
    reach_deg: float = 65.0,
    starts: int = 4,
    steps: int = 4000,
    seed: int = 0,
) -> None:
    """Search for the design that relights best in the light of a folder of maps, or of a day.

    The scene is a stand-in, solids on the ground. Maps of a folder are turned about the vertical;
    for a day at a place, skies are simulated, and the probe must stand with -Z north and +X
    east. Writes design.json, design.png and report.json, and says how much the design gains over
    the symmetric one on lights that the search did not see.

    Args:
        lights: Folder with .exr or .hdr maps.
        out: Folder for the results.
        category: Only maps of that category in the folder's index.csv, such as indoor.
        lat: Instead of a folder, the latitude of a place in degrees, north positive.
        lon: Its longitude, east positive.
        date: Day there, such as 2026-06-21.
        weathers: How many weathers that day may have.
        cells: How many cells the design has.
        name: Of the design; by default optimised-CELLS.
        held_out: Share of the maps, or weathers, that are kept back for the comparison.
        width_deg: Least distance of the cells' centres; by default half of that of even cells.
        reach_deg: How far a cell may reach from its centre; the further, the more the kernel's
            corners stick out.
        starts: Searches, of which the best counts.
        steps: Trials of each search.
        seed: Of all that is drawn at random.
    """
    import math

    from skylight.app.probes.partitions.design import (
        place_and_day,
        summarise_optimised,
        tailored_designs,
        write_optimised,
    )
    from skylight.app.progress import stage_bar
    from skylight.probes.partitions.design.lights import read_maps, simulated_lights
    from skylight.probes.partitions.design.optimise import SearchSettings
    from skylight.probes.partitions.design.tailored import optimise_for
    from skylight.work.results_folder import results_folder

    given = [each is not None for each in (lat, lon, date)]
    if any(given) != all(given) or any(given) == (lights is not None):
        raise InputError("give either --for with a folder, or --lat, --lon and --date together")
    sun = None
    if lat is not None and lon is not None and date is not None:
        sun = place_and_day(lat, lon, date)
    settings = SearchSettings(
        starts=starts,
        steps=steps,
        width_rad=None if width_deg is None else math.radians(width_deg),
        reach_rad=math.radians(reach_deg),
    )
    with stage_bar() as progress, results_folder(out) as folder:
        progress("reading maps", 0.0)
        if sun is not None:
            found = simulated_lights(*sun, weathers=weathers, tell=progress)
        else:
            assert lights is not None
            found = read_maps(lights, category)
        result = optimise_for(
            found,
            name or f"optimised-{cells}",
            cells,
            held_out=held_out,
            seed=seed,
            settings=settings,
            rivals=tailored_designs(cells, sun),
            tell=progress,
        )
        write_optimised(folder, result)
    print(summarise_optimised(result))
    print(f"written into {out}: design.json, design.png and report.json")
