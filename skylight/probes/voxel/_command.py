"""``skylight probe voxel``: design, printing, capture and rendering."""

from pathlib import Path
from typing import Literal

import tyro
from tyro.conf import Positional

from skylight._options import film_source, one_source, take_care
from skylight.errors import InputError

# Parsing must not import torch, so the choices stand here again.
Reconstruction = Literal["direct", "global"]

voxel = tyro.extras.SubcommandApp()


@voxel.command(name="print")
def print_voxel(
    out: Path,
    probe: int | None = None,
    voxels: Path | None = None,
    resolution: int = 8,
    face_mm: float = 20.0,
    wall_mm: float = 1.6,
    clearance_mm: float = 0.15,
    pole_mm: float = 6.0,
    pole_length_mm: float = 120.0,
    board_width_mm: float = 175.0,
    board_height_mm: float = 125.0,
) -> None:
    """Make a voxel probe for a 3D printer: thin-walled parts that press together without glue.

    Writes parts.stl and parts.3mf (all parts on the bed), part_NN.stl and foot.stl (each alone),
    marker_base.stl and .3mf (a plate for a printed ChArUco board and the pole), assembly.json (how
    the probe stands on the board, and the order of assembly), report.json (what was measured on
    the parts) and assembly.png.

    Args:
        out: Folder for the results.
        probe: Star-shaped probe so many voxels wide: 1, 3, 5, ...
        voxels: Another model: .npy (grid of booleans), .vox, or a mesh file.
        resolution: Voxels along the longest side of a mesh.
        face_mm: Side of a voxel.
        wall_mm: Thickness of the walls.
        clearance_mm: Gap per side between parts that slide together.
        pole_mm: Diameter of the pole, a round rod.
        pole_length_mm: Length of the pole.
        board_width_mm: Width of the printed ChArUco pattern, without margin.
        board_height_mm: Height of that pattern.
    """
    from skylight.probes.fabrication._mount import MarkerBoard, Pole
    from skylight.probes.fabrication._parts import PrintSizes
    from skylight.probes.voxel._model import probe_model
    from skylight.probes.voxel._printing import print_voxel_probe
    from skylight.probes.voxel._printing_files import (
        PART_FILES,
        summarise_print,
        write_printed_probe,
    )
    from skylight.work._progress import stage_bar
    from skylight.work._resumable import results_folder

    sizes = PrintSizes(face_mm=face_mm, wall_mm=wall_mm, clearance_mm=clearance_mm)
    pole = Pole(diameter_mm=pole_mm, length_mm=pole_length_mm)
    board = MarkerBoard(width_mm=board_width_mm, height_mm=board_height_mm)
    model, title = probe_model(probe, voxels, resolution)
    with stage_bar() as progress, results_folder(out, PART_FILES) as folder:
        result = print_voxel_probe(
            model, sizes, title=title, pole=pole, board=board, progress=progress
        )
        progress("writing the results", 0.7)
        write_printed_probe(folder, result)
    for problem in result.report.problems:
        take_care(problem)
    print(summarise_print(result))
    print(
        f"written into {out}: parts.stl, parts.3mf, assembly.png and others; the STL files, read "
        "back, are closed"
    )


@voxel.command(name="inspect")
def inspect_voxel(
    probe: int | None = None,
    voxels: Path | None = None,
    resolution: int = 8,
    albedo: float = 0.8,
) -> None:
    """Say which occlusion configurations a voxel model encodes, and what can be told from them.

    Args:
        probe: Star-shaped probe so many voxels wide: 1, 3, 5, ...
        voxels: Another model: .npy (grid of booleans), .vox, or a mesh file.
        resolution: Voxels along the longest side of a mesh.
        albedo: Of the printed material.
    """
    from skylight.probes.voxel._analysis import inspect
    from skylight.probes.voxel._model import probe_model

    model, title = probe_model(probe, voxels, resolution)
    report = inspect(model, albedo=albedo)
    print(f"{title}: {len(model)} voxels, {int(report.faces.sum())} faces")
    print(report.table())
    if not report.tractable:
        take_care("it encodes too little: direct light needs rank 5 on all six sides")


@voxel.command(name="design")
def design_voxel(
    out: Path,
    voxels: int = 37,
    size: int = 5,
    symmetric: bool = True,
    albedo: float = 0.8,
) -> None:
    """Search for the probe that tells most, and write it as a .npy grid.

    Grown voxel by voxel from one, connected through faces, by what cameras round it can see.

    Args:
        out: The .npy file, which `inspect`, `print` and others take as --voxels.
        voxels: How many voxels it may have at most.
        size: Side of the cube that it fits into; odd.
        symmetric: Only probes that look the same from all six sides.
        albedo: Of the printed material.
    """
    if out.suffix.lower() != ".npy":
        raise InputError(f"{out}: a design is written as .npy; choose another name")
    from skylight.probes.voxel._analysis import design_probe, probe_residual
    from skylight.probes.voxel._model import star_probe, write_voxels

    found = design_probe(voxels, size=size, symmetric=symmetric, albedo=albedo)
    write_voxels(out, found.model)
    stars = [star_probe(n) for n in (3, 5)]
    compared = ", ".join(
        f"{len(star)} voxels of the {n}-probe {probe_residual(star, albedo=albedo):.3f}"
        for n, star in zip((3, 5), stars, strict=True)
    )
    print(
        f"{out}: {len(found.model)} voxels, mean squared residual {found.residual:.3f} ({compared})"
    )


@voxel.command(name="capture")
def capture_voxel(
    photos: Positional[tuple[Path, ...]] = (),
    video: Path | None = None,
    webcam: int | None = None,
    camera: Path = Path("camera.json"),
    board: Path = Path("board.json"),
    assembly: Path = Path("assembly.json"),
    response: Path | None = None,
    out: Path = Path("capture"),
    frames: int = 40,
    more: bool = False,
) -> None:
    """Read the shading of a printed voxel probe from pictures taken all round it.

    Keep exposure, white balance and the light fixed. Writes lightmap.npz, lightmap.png,
    capture.json, and assembly.json, which says where the probe was found to stand.

    Args:
        photos: Pictures with the whole probe and most of its board in view.
        video: Instead of photos, a video; its sharp and different frames are used.
        webcam: Instead of photos, the number of a webcam, watched for 20 seconds.
        camera: The camera, as `skylight camera calibrate` wrote it.
        board: The board's measures, as `skylight camera board` wrote them.
        assembly: How the probe stands on it, as `skylight probe voxel print` wrote it.
        response: The camera's response, as `skylight camera response` wrote it; otherwise sRGB.
        out: Folder for the results.
        frames: Most frames to use of a video or webcam.
        more: Go on with the capture that is in OUT, in the same light and exposure.
    """
    from skylight.probes.cameras._files import read_setup
    from skylight.probes.voxel._capture_files import capture_voxel_probe

    capture_voxel_probe(
        one_source(photos, video, webcam),
        setup=read_setup(camera, board, response),
        assembly=assembly,
        out=out,
        most=frames,
        more=more,
        warn=take_care,
    )


@voxel.command(name="render")
def render_voxel(
    model: Positional[Path],
    lightmap: Path = Path("capture/lightmap.npz"),
    out: Path = Path("model.glb"),
    reconstruction: Reconstruction = "global",
    albedo: float = 0.8,
    resolution: int = 32,
    rotate: str = "",
    photo: Path | None = None,
    camera: Path = Path("camera.json"),
    board: Path = Path("board.json"),
    response: Path | None = None,
    at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    voxel_mm: float = 5.0,
) -> None:
    """Draw a voxel model with captured light: into a photo, or as a .glb that any viewer shows.

    Args:
        model: .npy (grid of booleans), .vox, or a mesh file, which is voxelised.
        lightmap: As `skylight probe voxel capture` wrote it.
        out: A .glb file, or a .png with --photo.
        reconstruction: How slots that no face of the probe shows are completed.
        albedo: Of the printed material.
        resolution: Voxels along the longest side of a mesh.
        rotate: Quarter turns of the model about its axes, such as y1 or x2,y3.
        photo: Picture with the board in view, into which the model is drawn.
        camera: The camera that took it, as `skylight camera calibrate` wrote it.
        board: The board's measures, as `skylight camera board` wrote them.
        response: The camera's response; otherwise sRGB.
        at_mm: Where the middle of the model's base stands: right, up and down the page from the
            pattern's upper left corner.
        voxel_mm: Side of a voxel, in a .glb too.
    """
    from skylight.probes.cameras._files import read_setup
    from skylight.probes.voxel._render_files import VoxelPlacement, render_voxels

    render_voxels(
        model,
        lightmap,
        out,
        kind=reconstruction,
        albedo=albedo,
        resolution=resolution,
        turns=rotate,
        photo=photo,
        setup=None if photo is None else read_setup(camera, board, response),
        placement=VoxelPlacement(x_mm=at_mm[0], y_mm=at_mm[1], z_mm=at_mm[2], voxel_mm=voxel_mm),
    )


@voxel.command(name="live")
def live_voxel(
    scene: Positional[Path],
    video: Path | None = None,
    webcam: int | None = None,
    camera: Path = Path("camera.json"),
    board: Path = Path("board.json"),
    assembly: Path = Path("assembly.json"),
    response: Path | None = None,
    out: Path = Path("live.mp4"),
    reconstruction: Reconstruction = "direct",
    albedo: float = 0.8,
    resolution: int = 24,
    rotate: str = "",
    at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    voxel_mm: float = 5.0,
    frames: int | None = None,
) -> None:
    """Track, capture, complete and draw, frame by frame, and write the film.

    The model appears as soon as some face of each side of the probe was seen. Says how long each
    stage takes. Ctrl-C ends a webcam's film.

    Args:
        scene: The voxel model: .npy, .vox, or a mesh file.
        video: A film with the probe and its board.
        webcam: Instead of it, the number of a webcam.
        camera: The camera, as `skylight camera calibrate` wrote it.
        board: The board's measures, as `skylight camera board` wrote them.
        assembly: How the probe stands on it, as `print` wrote it or, better, `capture`.
        response: The camera's response; otherwise sRGB.
        out: The film to write: .mp4, or .mkv without loss.
        reconstruction: How slots that no face of the probe shows are completed.
        albedo: Of the printed material.
        resolution: Voxels along the longest side of a mesh.
        rotate: Quarter turns of the model about its axes, such as y1 or x2,y3.
        at_mm: Where the middle of the model's base stands on the board.
        voxel_mm: Side of a voxel.
        frames: Stop after so many.
    """
    from skylight.probes.cameras._files import read_setup
    from skylight.probes.voxel._capture_files import live_film
    from skylight.probes.voxel._model import read_voxels
    from skylight.probes.voxel._render_files import VoxelPlacement, turned

    live_film(
        film_source(video, webcam),
        out,
        setup=read_setup(camera, board, response),
        assembly=assembly,
        model=turned(read_voxels(scene, resolution=resolution), rotate),
        placement=VoxelPlacement(x_mm=at_mm[0], y_mm=at_mm[1], z_mm=at_mm[2], voxel_mm=voxel_mm),
        kind=reconstruction,
        albedo=albedo,
        most=frames,
    )
