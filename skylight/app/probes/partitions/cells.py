"""Designs of partition probes by name, from files, and for a day's sun path."""

import math
from pathlib import Path

from skylight.app.probes.partitions.design import place_and_day
from skylight.errors import InputError
from skylight.io.files import write_png
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design.designs import design_names, named_design
from skylight.probes.partitions.design.sun_path import path_design, sun_path
from skylight.probes.partitions.picture import draw_cells
from skylight.probes.partitions.seeds import ProbeDesign, load_design, save_design

_SIZE_MOST = 4000

PlaceAndDay = tuple[float, float, str]


def find_design(told: str, sun: PlaceAndDay | None = None, path_cells: int = 12) -> ProbeDesign:
    """The design of that name or in that file, divided along the sun's path where one is given.

    ``sun`` is the latitude and longitude in degrees, and the day as YYYY-MM-DD.
    """
    base = load_design(told) if told.lower().endswith(".json") else named_design(told)
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
