"""What the files of printed probes hold, read back: the tables of the two probes' pages.

    python -m tools.measure_prints

Every named design of the partitions probe and three voxel probes, each with sizes that are chosen
by themselves; and their mounts for other poles. Takes minutes. The numbers are those of each
print's report.json; none is written by hand.
"""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from skylight.io._atomic import atomic_path
from skylight.io._bounded import json_content
from skylight.probes.fabrication._mount import Pole
from skylight.probes.fabrication._parts import PrintSizes
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions._printing_files import write_printed_partitions
from skylight.probes.partitions.printed._assembly import AskedSizes
from skylight.probes.partitions.printed._printing import print_fitted
from skylight.probes.voxel._model import star_probe
from skylight.probes.voxel._printing import print_voxel_probe
from skylight.probes.voxel._printing_files import write_printed_probe

ROOT = Path(__file__).parents[1]
_BEGIN, _END = "<!-- written by tools/measure_prints.py: -->\n", "<!-- until here -->"
_POLES_MM = (4.0, 10.0)  # beside the 6 mm of all others
_HEAD = ("print", "files", "triangles", "watertight as read back", "least wall mm", "material cm3")


def main() -> None:
    for probe, rows in (("partition", partitions()), ("voxel", voxels())):
        write_section(ROOT / "docs" / f"{probe}_probe.md", list(rows))


def partitions() -> Iterator[dict[str, Any]]:
    """Of every named design, and of the coarsest on other poles."""
    prints = [(name, Pole(length_mm=190.0)) for name in design_names()]
    prints += [("6d", Pole(diameter_mm=mm, length_mm=190.0)) for mm in _POLES_MM]
    for name, pole in prints:
        result = print_fitted(named_design(name), AskedSizes(), pole=pole)
        with tempfile.TemporaryDirectory() as folder:
            write_printed_partitions(Path(folder), result, panel_px=60)
            yield facts_of(_named(name, pole), Path(folder))


def voxels() -> Iterator[dict[str, Any]]:
    """The probes of the thesis and a single cube, and the 3-probe on other poles."""
    prints = [(size, Pole()) for size in (1, 3, 5)]
    prints += [(3, Pole(diameter_mm=mm)) for mm in _POLES_MM]
    for size, pole in prints:
        title = _named(f"{size}-probe", pole)
        result = print_voxel_probe(star_probe(size), PrintSizes(), title=title, pole=pole)
        with tempfile.TemporaryDirectory() as folder:
            write_printed_probe(Path(folder), result, panel_px=60)
            yield facts_of(title, Path(folder))


def _named(name: str, pole: Pole) -> str:
    return name if pole.diameter_mm == Pole().diameter_mm else f"{name}, pole {pole.diameter_mm:g}"


def facts_of(name: str, folder: Path) -> dict[str, Any]:
    """Of a folder that a print was written into; the marker base is one of its files."""
    report = json_content(folder / "report.json")
    parts = [file for file in report["files"] if file["name"] != "parts.stl"]
    return {
        "name": name,
        "files": len(report["files"]),
        "triangles": sum(file["triangles"] for file in parts),
        "watertight": sum(file["watertight"] for file in report["files"]),
        "thinnest_wall_mm": report["thinnest_wall_mm"],
        "volume_mm3": sum(file["volume_mm3"] for file in parts),
    }


def write_section(page: Path, rows: Sequence[dict[str, Any]]) -> None:
    """The table, between the marks that tell where it is in the page."""
    before, _, rest = page.read_text(encoding="utf-8").partition(_BEGIN)
    _, _, after = rest.partition(_END)
    cells = [
        (
            row["name"],
            row["files"],
            row["triangles"],
            "all" if row["watertight"] == row["files"] else row["watertight"],
            f"{row['thinnest_wall_mm']:.2f}",
            f"{row['volume_mm3'] / 1000:.1f}",
        )
        for row in rows
    ]
    lines = [_HEAD, ("---", *["---:"] * (len(_HEAD) - 1)), *cells]
    table = "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)
    with atomic_path(page) as temporary:
        temporary.write_text(f"{before}{_BEGIN}\n{table}\n\n{_END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
