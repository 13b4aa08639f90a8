"""Partition-probe designs optimised for a folder of maps or for simulated skies; files to files."""

from dataclasses import asdict
from datetime import date
from pathlib import Path

from skylight.errors import InputError
from skylight.io.files import write_png
from skylight.io.json_files import write_json
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design.designs import named_design
from skylight.probes.partitions.design.sun_path import path_design, sun_path
from skylight.probes.partitions.design.tailored import Optimised
from skylight.probes.partitions.picture import draw_cells
from skylight.probes.partitions.seeds import ProbeDesign, save_design
from skylight.skies.sun import Place


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
