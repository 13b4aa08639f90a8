"""``skylight probe partitions``: designs, printing and capture."""

from pathlib import Path

import tyro
from tyro.conf import Positional

from skylight._options import one_source, take_care
from skylight.errors import InputError
from skylight.probes.partitions._design_command import design_partitions, export, live, relight

partitions = tyro.extras.SubcommandApp()

Box = tuple[int, int, int, int]  # x, y of the upper left corner, width, height; px


@partitions.command(name="cells")
def cells_of_a_design(
    design: Positional[str] = "",
    out: Path | None = None,
    save: Path | None = None,
    lat: float | None = None,
    lon: float | None = None,
    date: str | None = None,
    path_cells: int = 12,
    size: int = 480,
) -> None:
    """List the named designs; or say which cells one has, draw them, and save the design.

    With --lat, --lon and --date the cells along that day's sun path are divided finely. Such a
    probe's -Z is north and +X east, and it must stand like that.

    Args:
        design: A named design or a design file; without it, the names are listed.
        out: A .png of the cells from two opposite sides.
        save: A .json design file to write, which others take as design.
        lat: Latitude of the place in degrees, north positive.
        lon: Longitude in degrees, east positive.
        date: Day of the sun path, such as 2026-06-21.
        path_cells: Cells along the sun path.
        size: Height of the picture in pixels.
    """
    from skylight.probes.partitions._design_files import describe_designs, find_design, write_cells

    sun = _sun(lat, lon, date)
    if not design:
        if not (sun is None and out is None and save is None):
            raise InputError("name a design, such as 14d")
        print(describe_designs())
        return
    print(write_cells(find_design(design, sun, path_cells), out, save, size=size))


@partitions.command(name="print")
def print_partitions(
    design: Positional[str],
    out: Path,
    lat: float | None = None,
    lon: float | None = None,
    date: str | None = None,
    path_cells: int = 12,
    outer_mm: float | None = None,
    kernel_mm: float | None = None,
    wall_mm: float | None = None,
    flare: float | None = None,
    clearance_mm: float = 0.15,
    bed_mm: float = 220.0,
    pole_mm: float = 6.0,
    pole_length_mm: float = 190.0,
    board_width_mm: float = 175.0,
    board_height_mm: float = 125.0,
) -> None:
    """Make a partition probe for a 3D printer: two half shells and the kernel between them.

    Print the shells black, or paint them, and the kernel white. Writes parts.stl and parts.3mf
    (all parts on the bed), each part alone, marker_base.stl and .3mf (a plate for a printed
    ChArUco board and the pole), assembly.json (how the probe stands on the board, what its faces
    see, and the order of assembly), report.json (what was measured) and assembly.png.

    Sizes that are not given are chosen: the smallest that can be printed and read.

    Args:
        design: A named design (`cells` lists them) or a design file.
        out: Folder for the results.
        lat: Divide the cells along a day's sun path: latitude in degrees, north positive.
        lon: Longitude, east positive.
        date: Day of the sun path, such as 2026-06-21.
        path_cells: Cells along the sun path.
        outer_mm: Diameter of the shell; without it 80 or more, ten times the kernel's distance.
        kernel_mm: Distance of the kernel's faces from the centre: the smaller, the less light of
            other cells a face sees, and the harder it is to read.
        wall_mm: Thickness of the walls; 1.6, or 0.8 for shells that would not fit on the bed.
        flare: How far walls grow thicker outwards, so that less light of other cells comes in: 0
            not at all, 1 as far as hides nothing of a cell from its face.
        clearance_mm: Gap per side between parts that meet.
        bed_mm: Side of the printer's bed; what does not fit on it is told.
        pole_mm: Diameter of the pole, a round rod.
        pole_length_mm: Length of the pole; longer for a larger shell, so that cameras that look
            into the upper cells see the board beside it.
        board_width_mm: Width of the printed ChArUco pattern, without margin.
        board_height_mm: Height of that pattern.
    """
    from skylight.probes.fabrication._mount import MarkerBoard, Pole
    from skylight.probes.partitions._design_files import find_design
    from skylight.probes.partitions._printing_files import (
        summarise_partition_print,
        write_printed_partitions,
    )
    from skylight.probes.partitions.printed._assembly import AskedSizes
    from skylight.probes.partitions.printed._printing import print_fitted
    from skylight.work._progress import stage_bar
    from skylight.work._resumable import results_folder

    found = find_design(design, _sun(lat, lon, date), path_cells)
    asked = AskedSizes(
        outer_mm=outer_mm,
        kernel_mm=kernel_mm,
        wall_mm=wall_mm,
        clearance_mm=clearance_mm,
        flare=flare,
    )
    pole = Pole(diameter_mm=pole_mm, length_mm=pole_length_mm)
    board = MarkerBoard(width_mm=board_width_mm, height_mm=board_height_mm)
    with stage_bar() as progress, results_folder(out) as folder:
        result = print_fitted(
            found, asked, pole=pole, board=board, bed_mm=bed_mm, progress=progress
        )
        progress("writing the results", 0.9)
        write_printed_partitions(folder, result)
    for problem in [*result.report.problems, *result.too_large(bed_mm), *result.warnings]:
        take_care(problem)
    print(summarise_partition_print(result))
    print(
        f"written into {out}: parts.stl, parts.3mf, assembly.png and others; the STL files, read "
        "back, are closed"
    )


@partitions.command(name="albedo")
def albedo_of_a_kernel(
    photo: Positional[Path],
    patch: Box,
    card: Box | None = None,
    card_albedo: float | None = None,
    response: Path | None = None,
    out: Path = Path("albedo.json"),
) -> None:
    """Measure the albedo of the kernel's material from a photo of it beside a known surface.

    That is a ColorChecker, which is found by itself, or a grey card. Rectangles are x, y of the
    upper left corner, width and height in pixels.

    Args:
        photo: The photo, in even light.
        patch: Rectangle of the material, flat and beside the card or chart.
        card: Rectangle of a grey card.
        card_albedo: Its albedo, such as 0.18.
        response: The camera's response, as `skylight camera response` wrote it; otherwise sRGB.
        out: File to write, which `capture` takes as --albedo.
    """
    from skylight.probes.partitions._kernel_albedo import measure_albedo

    found = measure_albedo(
        photo,
        out,
        patch=patch,
        card=card,
        card_albedo=card_albedo,
        response=response,
        warn=take_care,
    )
    told = ", ".join(f"{v:.3f} +- {e:.3f}" for v, e in zip(found.rgb, found.error, strict=True))
    print(f"{out}: albedo {told} (red, green, blue), by a {found.reference}")


@partitions.command(name="capture")
def capture_partitions(
    photos: Positional[tuple[Path, ...]] = (),
    video: Path | None = None,
    webcam: int | None = None,
    camera: Path = Path("camera.json"),
    board: Path = Path("board.json"),
    assembly: Path = Path("assembly.json"),
    response: Path | None = None,
    albedo: str | None = None,
    out: Path = Path("capture"),
    frames: int = 40,
    more: bool = False,
) -> None:
    """Read the shading of a printed probe's kernel from pictures that look into all cells.

    Keep exposure, white balance and the light fixed. Writes shading.json, capture.json and
    assembly.json.

    Args:
        photos: Pictures with the whole probe and most of its board in view.
        video: Instead of photos, a video; its sharp and different frames are used.
        webcam: Instead of photos, the number of a webcam, watched for 20 seconds.
        camera: The camera, as `skylight camera calibrate` wrote it.
        board: The board's measures, as `skylight camera board` wrote them.
        assembly: How the probe stands on it, as `skylight probe partitions print` wrote it.
        response: The camera's response, as `skylight camera response` wrote it; otherwise sRGB.
        albedo: Of the kernel: a number, or a file that `albedo` wrote; otherwise 0.8.
        out: Folder for the results.
        frames: Most frames to use of a video or webcam.
        more: Go on with the capture that is in OUT, in the same light and exposure.
    """
    from skylight.probes.cameras._files import read_setup
    from skylight.probes.partitions._capture_files import capture_partition_probe
    from skylight.probes.partitions._kernel_albedo import read_albedo

    capture_partition_probe(
        one_source(photos, video, webcam),
        setup=read_setup(camera, board, response),
        assembly=assembly,
        out=out,
        albedo=read_albedo(albedo),
        most=frames,
        more=more,
        warn=take_care,
    )


def _sun(lat: float | None, lon: float | None, date: str | None) -> tuple[float, float, str] | None:
    """Place and day of a sun path, all or nothing."""
    if lat is None and lon is None and date is None:
        return None
    if lat is None or lon is None or date is None:
        raise InputError("a sun path needs --lat, --lon and --date together")
    return lat, lon, date


partitions.command(name="relight")(relight)
partitions.command(name="live")(live)
partitions.command(name="export")(export)
partitions.command(name="design")(design_partitions)
