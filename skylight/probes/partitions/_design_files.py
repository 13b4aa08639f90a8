"""Designs of partition probes: by name, from files, along a day's sun path, or searched for."""

import math
from dataclasses import asdict
from datetime import date
from pathlib import Path

from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.io._files import write_png
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import Optimised, design_names, named_design
from skylight.probes.partitions._picture import draw_cells
from skylight.probes.partitions._seeds import ProbeDesign, load_design, save_design
from skylight.probes.partitions._sun_path import path_design, sun_path
from skylight.skies._sun import Place

_SIZE_MOST = 4000

PlaceAndDay = tuple[float, float, str]


def find_design(design: str, sun: PlaceAndDay | None = None, path_cells: int = 12) -> ProbeDesign:
    """The design of that name or in that file, divided along the sun's path where one is given.

    ``sun`` is the latitude and longitude in degrees, and the day as YYYY-MM-DD.
    """
    base = load_design(design) if design.lower().endswith(".json") else named_design(design)
    if sun is None:
        return base
    place, when = place_and_day(*sun)
    path = sun_path(place, when)
    name = f"{base.name}-sun-{path_cells}-{when.isoformat()}"
    return path_design(name, base, path_cells, path)


def describe_designs() -> str:
    """The named designs, one a line."""
    return "\n".join(f"{name:<20}{named_design(name).count:>4} cells" for name in design_names())


def write_cells(design: ProbeDesign, out: Path | None, save: Path | None, *, size: int) -> str:
    """What there is to say of a design's cells; with their picture and file, where asked for."""
    if out is not None and out.suffix.lower() != ".png":
        raise InputError(f"{out}: the picture is written as .png; choose another name")
    if save is not None and save.suffix.lower() != ".json":
        raise InputError(f"{save}: designs are written as .json; choose another name")
    if not 16 <= size <= _SIZE_MOST:
        raise InputError(f"the picture must be 16 to {_SIZE_MOST} pixels high, got {size}")
    cells = Cells.of(design)
    if out is not None:
        write_png(out, draw_cells(cells, size=size))
    if save is not None:
        save_design(save, design)
    return describe_cells(cells)


def describe_cells(cells: Cells) -> str:
    """A table: where each cell looks, and how large it is."""
    stand = ", to be placed with -Z north and +X east" if cells.design.oriented else ""
    lines = [
        f"{cells.design.name}: {cells.count} cells{stand}",
        "cell     x      y      z      sr  facing/pi",
    ]
    # rounded first, so that no -0.00 is printed
    rounded = (cells.normals * 100).round() / 100 + 0.0
    share = (cells.facing / math.pi).tolist()
    table = zip(rounded.tolist(), cells.solid_angles.tolist(), share, strict=True)
    lines += [
        f"{i:>4} {x:6.2f} {y:6.2f} {z:6.2f} {sr:7.3f} {seen:10.3f}"
        for i, ((x, y, z), sr, seen) in enumerate(table)
    ]
    return "\n".join(lines)


def place_and_day(latitude_deg: float, longitude_deg: float, day: str) -> tuple[Place, date]:
    """As users write them: degrees north and east, and YYYY-MM-DD."""
    if not (-90 <= latitude_deg <= 90 and -180 <= longitude_deg <= 180):
        raise InputError(
            f"{latitude_deg:g}, {longitude_deg:g} is no place: latitudes are -90 to 90, longitudes "
            "-180 to 180 degrees"
        )
    try:
        return Place(latitude_deg=latitude_deg, longitude_deg=longitude_deg), date.fromisoformat(
            day
        )
    except ValueError as error:
        raise InputError(f"{day!r} is no day: write it as 2026-06-21") from error


def tailored_designs(count: int, sun: tuple[Place, date] | None = None) -> list[ProbeDesign]:
    """The thesis' designs of so many cells for such light: for rooms, or for a day's sun path."""
    if sun is None:
        return [named_design("14d-indoor")] if count == 14 else []
    path = sun_path(*sun)
    base = named_design("6d")
    # where the path runs through base cells they are cut, which makes more of them
    for cells in range(count - 1, 0, -1):
        design = path_design(f"6d-sun-{cells}", base, cells, path)
        if design.count == count:
            return [design]
    return []


def write_optimised(folder: Path, result: Optimised) -> None:
    """design.json, design.png and report.json."""
    save_design(folder / "design.json", result.design)
    write_png(folder / "design.png", draw_cells(Cells.of(result.design)))
    write_json(
        folder / "report.json",
        {
            "design": result.design.name,
            "mae": {name: asdict(score) for name, score in result.scores.items()},
            "gain": result.gain,
            "training": result.training,
            "held_out": result.held_out,
        },
    )


def summarise_optimised(result: Optimised) -> str:
    """A table of the scores, and the gain."""
    lines = ["relighting MAE          searched on   held out"]
    lines += [
        f"{name:<24}{score.training:>11.4f}{score.held_out:>11.4f}"
        for name, score in result.scores.items()
    ]
    first = next(iter(result.scores))
    less = "less" if result.gain >= 0 else "more"
    lines.append(
        f"{result.design.name} errs {abs(result.gain):.1%} {less} than {first} on "
        f"{len(result.held_out)} lights that the search did not see"
    )
    return "\n".join(lines)
