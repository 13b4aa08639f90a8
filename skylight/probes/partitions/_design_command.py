"""``skylight probe partitions design``, ``relight``, ``live`` and ``export``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, arg

from skylight._options import film_source, take_care
from skylight.errors import InputError

if TYPE_CHECKING:
    from skylight.probes.partitions._relight_files import VirtualScene


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

    from skylight.probes.partitions._design_files import (
        place_and_day,
        summarise_optimised,
        tailored_designs,
        write_optimised,
    )
    from skylight.probes.partitions._optimise import SearchSettings, optimise_for
    from skylight.probes.partitions._sun_path import read_maps, simulated_lights
    from skylight.work._progress import stage_bar
    from skylight.work._resumable import results_folder

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


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """A virtual scene on the board.

    Args:
        scene: The mesh file.
        at_mm: Where the middle of its base stands: right, up and down the page from the pattern's
            upper left corner.
        height_mm: Its height; without height and scale, its longest side is 60 mm.
        scale: Millimetres for each unit of the mesh, instead of the height.
        turn_deg: Turn about the vertical, counter-clockwise seen from above.
        albedo: Red, green and blue in 0..1, linear, of a mesh without colours.
        ground_albedo: Of what the scene stands on, for the light that goes to and fro.
        edge_mm: Triangles with longer edges are divided.
        rays: How many leave each vertex.
        bounces: How often light may bounce.
        cache: File for the transfer coefficients, used again for the same scene and probe; without
            it, OUT with the ending .transfer.npz, or .turning.npz of a scene that turns.
        workers: Processes that cast rays.
    """

    scene: Path
    at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height_mm: float | None = None
    scale: float | None = None
    turn_deg: float = 0.0
    albedo: tuple[float, float, float] = (0.7, 0.7, 0.7)
    ground_albedo: float = 0.5
    edge_mm: float = 4.0
    rays: int = 512
    bounces: int = 3
    cache: Path | None = None
    workers: int = 2

    def read(self, out: Path, angles: int | None = None) -> "VirtualScene":
        from skylight.probes.partitions._relight_files import ScenePlacement, VirtualScene
        from skylight.probes.partitions.relight._transfer import TransferSampling

        if self.workers < 1:
            raise InputError(f"{self.workers} workers cannot work: use 1 or more")
        x, y, z = self.at_mm
        return VirtualScene(
            mesh=self.scene,
            placement=ScenePlacement(
                x_mm=x, y_mm=y, z_mm=z,
                height_mm=self.height_mm, scale=self.scale, turn_deg=self.turn_deg,
            ),
            cache=self.cache or out.with_suffix(".turning.npz" if angles else ".transfer.npz"),
            albedo=self.albedo,
            ground_albedo=self.ground_albedo,
            edge_mm=self.edge_mm,
            sampling=TransferSampling(rays=self.rays, bounces=self.bounces),
            workers=self.workers,
            angles=angles,
        )  # fmt: skip


def relight(
    virtual: Annotated[SceneOptions, OmitArgPrefixes],
    photo: Path,
    probe: Path = Path("capture/assembly.json"),
    capture: Path = Path("capture/shading.json"),
    camera: Path = Path("camera.json"),
    board: Path = Path("board.json"),
    response: Path | None = None,
    angles: int | None = None,
    out: Path = Path("scene.png"),
) -> None:
    """Put a virtual scene into a photo of the board, in the light that the probe captured.

    It stands on the board, which takes its shadow and the light that it throws.

    Args:
        virtual: The scene.
        photo: Picture with most of the board in view.
        probe: The printed probe and its place, as `print` or `capture` wrote it.
        capture: Its shading, as `capture` wrote it.
        camera: The camera that took the photo, as `skylight camera calibrate` wrote it.
        board: The board's measures, as `skylight camera board` wrote them.
        response: The camera's response; otherwise sRGB.
        angles: Keep transfer coefficients of so many angles of a whole turn, as `live` does, so
            that any --turn-deg with the same --cache is drawn without casting rays again.
        out: The .png to write.
    """
    from skylight.probes.cameras._files import read_setup
    from skylight.probes.partitions._relight_files import relight_scene

    relight_scene(
        virtual.read(out, angles),
        photo,
        out,
        assembly=probe,
        capture=capture,
        setup=read_setup(camera, board, response),
        warn=take_care,
    )


def live(
    virtual: Annotated[SceneOptions, OmitArgPrefixes],
    video: Path | None = None,
    webcam: int | None = None,
    probe: Path = Path("assembly.json"),
    capture: Path | None = None,
    kernel_albedo: str | None = None,
    camera: Path = Path("camera.json"),
    board: Path = Path("board.json"),
    response: Path | None = None,
    turn_deg_per_s: float = 0.0,
    angles: int | None = None,
    out: Path = Path("live.mp4"),
    frames: int | None = None,
) -> None:
    """Track, look into the probe, relight and draw, frame by frame, and write the film.

    The scene appears as soon as half of the cells were seen, and follows when the light changes.
    Says how long each stage takes. Ctrl-C ends a webcam's film.

    Args:
        virtual: The scene.
        video: A film with the probe and its board.
        webcam: Instead of it, the number of a webcam.
        probe: The printed probe and its place, as `print` or `capture` wrote it.
        capture: Shading to begin with, as `capture` wrote it, with the kernel's albedo.
        kernel_albedo: Without --capture: a number, or a file that `albedo` wrote; otherwise 0.8.
        camera: The camera, as `skylight camera calibrate` wrote it.
        board: The board's measures, as `skylight camera board` wrote them.
        response: The camera's response; otherwise sRGB.
        turn_deg_per_s: The scene turns by so much about the vertical, counter-clockwise seen from
            above, in the film's own time (a webcam's frames are 30 a second), from --turn-deg on.
        angles: With --turn-deg-per-s: at how many angles of a whole turn transfer coefficients are
            made (24 unless given); light is interpolated in between.
        out: The film to write: .mp4, or .mkv without loss.
        frames: Stop after so many.
    """
    from skylight.probes.cameras._files import read_setup
    from skylight.probes.partitions._kernel_albedo import read_albedo
    from skylight.probes.partitions._relight_files import live_scene
    from skylight.probes.partitions.relight._transfer import Turn

    if capture is not None and kernel_albedo is not None:
        raise InputError("the capture has the kernel's albedo: give it without --kernel-albedo")
    if angles is not None and not turn_deg_per_s:
        raise InputError("--angles is for scenes that turn: give it with --turn-deg-per-s")
    if turn_deg_per_s and angles is None:
        angles = Turn().angles
    live_scene(
        film_source(video, webcam),
        out,
        scene=virtual.read(out, angles),
        setup=read_setup(camera, board, response),
        assembly=probe,
        capture=capture,
        turn_deg_per_s=turn_deg_per_s,
        albedo=read_albedo(kernel_albedo).rgb,
        most=frames,
        warn=take_care,
    )


def export(
    virtual: Annotated[SceneOptions, OmitArgPrefixes],
    probe: Path = Path("capture/assembly.json"),
    capture: Path = Path("capture/shading.json"),
    exposure: float = 1.0,
    atlas_px: int | None = None,
    out: Path = Path("scene.glb"),
) -> None:
    """Write a scene as .glb with its light baked in, and the coefficients to light it anew.

    Any viewer shows the baked colours; docs/relightable_glb.md says how an engine relights it.

    Args:
        virtual: The scene.
        probe: The printed probe and its place, as `print` or `capture` wrote it.
        capture: Its shading, as `capture` wrote it.
        exposure: The baked colours are the light times this.
        atlas_px: Work the light out at the texels of a texture so wide and high instead of at
            the vertices; the coefficients go to OUT with the ending .atlas.npz, and to the cache
            in place of the vertices'.
        out: The .glb to write.
    """
    from skylight.probes.partitions._relight_files import export_scene

    export_scene(
        virtual.read(out),
        out,
        assembly=probe,
        capture=capture,
        exposure=exposure,
        atlas_px=atlas_px,
        warn=take_care,
    )
