"""Virtual scenes in photographs, films and .glb files, lit by a captured probe; files to files."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging._film import film_rate
from skylight.io._atomic import require_place
from skylight.io._files import write_png
from skylight.probes._capture import pose_in_photo
from skylight.probes.cameras._drawing import box_edges, is_empty, lens_rays, window_of
from skylight.probes.cameras._files import Setup
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._live import LiveReport, check_film
from skylight.probes.partitions._capture_files import completed_shading
from skylight.probes.partitions._captured import ProbeCapture, load_capture, nonnegative_light
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._kernel_albedo import read_albedo
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.printed._assembly import (
    PartitionAssembly,
    PlacedPartitions,
    load_partition_assembly,
)
from skylight.probes.partitions.relight._atlas import Atlas, UnusableLayout, refined
from skylight.probes.partitions.relight._composite import (
    Mesh,
    SceneOnBoard,
    board_transfer,
    in_probe_frame,
    meets,
)
from skylight.probes.partitions.relight._export import (
    Baking,
    atlas_path,
    write_relightable_atlas,
    write_relightable_glb,
)
from skylight.probes.partitions.relight._gather import Ground
from skylight.probes.partitions.relight._live import PartitionLiveView, RunningShading
from skylight.probes.partitions.relight._scene import DEFAULT_ALBEDO, Scene, read_scene
from skylight.probes.partitions.relight._transfer import (
    TransferCoefficients,
    TransferSampling,
    Turn,
    kept_transfer,
)
from skylight.sphere._rotation import RigidTransform
from skylight.work._progress import Tell, stage_bar

_UNEXPLAINED = 0.02  # of the shading, root mean square; noise of a capture is below
_SAMPLES = 3  # along each side of a pixel
_LARGEST_MM = 60.0  # of a scene whose size nobody names
_METRES = 0.001  # of a millimetre


@dataclass(frozen=True, kw_only=True)
class ScenePlacement:
    """Position of a scene on the board (the middle of its base), its size and rotation.

    Either ``height_mm`` or ``scale`` (mm for each of its units); without both, its longest side is
    60 mm. ``turn_deg`` is counter-clockwise seen from above.
    """

    x_mm: float
    z_mm: float
    y_mm: float = 0.0
    height_mm: float | None = None
    scale: float | None = None
    turn_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.height_mm is not None and self.scale is not None:
            raise InputError("give a scene's height or its scale, not both")
        sizes = [size for size in (self.height_mm, self.scale) if size is not None]
        numbers = (self.x_mm, self.y_mm, self.z_mm, self.turn_deg, *sizes)
        if not all(map(math.isfinite, numbers)) or any(size <= 0 for size in sizes):
            raise InputError("a scene needs a place in finite mm and a size above 0")
        if self.y_mm < 0:
            raise InputError(f"the scene would stand {-self.y_mm:g} mm below the board")

    def placed(self, scene: Scene) -> Scene:
        """The scene in millimetres of the board."""
        low, high = scene.vertices.amin(0), scene.vertices.amax(0)
        rise, longest = float(high[1] - low[1]), float((high - low).max())
        if self.height_mm is not None and rise == 0:
            raise InputError("a flat scene has no height: give its scale")
        if longest == 0:
            raise InputError("all of the scene's vertices are in one place")
        if self.scale is not None:
            size = self.scale
        elif self.height_mm is not None:
            size = self.height_mm / rise
        else:
            size = _LARGEST_MM / longest
        sine, cosine = (f(math.radians(self.turn_deg)) for f in (math.sin, math.cos))
        matrix = torch.eye(4, dtype=torch.float64)
        matrix[:3, :3] = size * torch.tensor(
            [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], dtype=torch.float64
        )
        base = torch.stack([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
        place = torch.tensor([self.x_mm, self.y_mm, self.z_mm], dtype=torch.float64)
        matrix[:3, 3] = place - matrix[:3, :3] @ base
        return scene.placed(matrix)


@dataclass(frozen=True, kw_only=True)
class VirtualScene:
    """A mesh file, its placement, and how its transfer coefficients are computed.

    ``albedo`` is for meshes without colours. No edge is left longer than ``edge_mm``, so that
    shadows show on large triangles. The coefficients are kept in the file ``cache``; those of so
    many ``angles`` of a turn about the vertical let a scene turn, to begin with by
    ``placement.turn_deg``.
    """

    mesh: Path
    placement: ScenePlacement
    cache: Path
    albedo: tuple[float, float, float] = DEFAULT_ALBEDO
    ground_albedo: float = 0.5
    edge_mm: float = 4.0
    sampling: TransferSampling = field(default_factory=TransferSampling)
    workers: int = 1
    angles: int | None = None

    def require(self, out: Path) -> None:
        """Refuse what cannot be used, before any work: ``out``, the cache's place, the mesh."""
        require_place(out)
        require_place(self.cache)
        if self.angles is not None:
            Turn(angles=self.angles)
        _ = self.placed

    @cached_property
    def placed(self) -> tuple[Scene, Ground]:
        """In millimetres of the board, in triangles that are small enough, and what is below."""
        placement = self.placement if self.angles is None else replace(self.placement, turn_deg=0.0)
        scene = refined(placement.placed(read_scene(self.mesh, self.albedo)), self.edge_mm)
        return scene, Ground.under(scene, albedo=self.ground_albedo)

    def is_seen(self, pose: RigidTransform, intrinsics: Intrinsics) -> bool:
        """Whether the scene or its ground is in the camera's picture, hidden or not."""
        scene, ground = self.placed
        around = [each.vertices.aminmax(dim=0) for each in (scene, ground.scene())]
        return not all(
            is_empty(window_of(box_edges(low, high).numpy(), pose, intrinsics))
            for low, high in around
        )

    def beside(
        self,
        real: PlacedPartitions,
        cells: Cells,
        rotation: Float[Tensor, "3 3"],
        warn: Tell,
        *,
        drawn_rad: float | None = None,
    ) -> SceneOnBoard:
        """Hidden by the real probe; says where a scene and that are in one place.

        A turning scene is looked at where it is drawn, or at all its angles.
        """
        vertices, triangles = real.vertices, real.triangles
        made = self.on_board(cells, rotation, (vertices, triangles))
        if self.angles is None:
            meeting = meets(self.placed[0], (vertices, triangles))
        else:
            every = Turn(angles=self.angles).angles_rad if drawn_rad is None else [drawn_rad]
            meeting = any(
                meets(self.placed[0], (made.turned(-angle).points(vertices), triangles))
                for angle in every
            )
        if meeting:
            warn("the scene and the probe or its pole are in one place: see --at-mm")
        return made

    def on_board(
        self, cells: Cells, rotation: Float[Tensor, "3 3"], real: Mesh | None = None
    ) -> SceneOnBoard:
        """Ready to be lit by a probe that is turned like that, and hidden by its mesh."""
        scene, ground = self.placed
        with stage_bar() as progress:
            transfer = board_transfer(
                self.cache,
                scene,
                ground,
                cells,
                rotation,
                angles=self.angles,
                sampling=self.sampling,
                workers=self.workers,
                progress=lambda share: progress("transfer coefficients", share),
            )
        return SceneOnBoard(scene, ground, transfer, cells, rotation, real)


def read_probe(
    assembly: Path, capture: Path | None, albedo: Float[Tensor, "3"] | None = None
) -> tuple[PartitionAssembly, PartitionProbe, ProbeCapture]:
    """A printed probe, what it makes of light, and its capture: blank where none is named."""
    printed = load_partition_assembly(assembly)
    if capture is None:
        plain = read_albedo(None).rgb if albedo is None else albedo
        captured = ProbeCapture.blank(printed.design, plain)
    else:
        captured = load_capture(capture)
        captured.require_design(printed.design)
    probe = PartitionProbe(printed.cells, captured.albedo, response=printed.response)
    return printed, probe.requires_grad_(False), captured


def captured_light(
    capture: ProbeCapture, printed: PartitionAssembly, probe: PartitionProbe, warn: Tell
) -> Float[Tensor, "n 3"]:
    """Radiance of each cell, 0 or more, 1 is the camera's largest code.

    Says which cells are guessed, and when no light of the cells explains the shading.
    """
    light, left = nonnegative_light(completed_shading(capture, printed, probe, warn), probe)
    if left > _UNEXPLAINED:
        warn(
            f"{left:.0%} of the shading is explained by no light of the cells: the probe is "
            "turned otherwise than the assembly says, its kernel has another albedo, or the light "
            "moved"
        )
    return light


def relight_scene(
    scene: VirtualScene,
    photo: Path,
    out: Path,
    *,
    assembly: Path,
    capture: Path,
    setup: Setup,
    tell: Tell = print,
    warn: Tell = print,
) -> None:
    """``out`` (.png): the photo with the scene on the board, its shadow and its bounce.

    Raises
    ------
    InputError
        A file cannot be used, the photo does not show the board, or not where the scene stands.
    """
    if out.suffix.lower() != ".png":
        raise InputError(f"{out}: pictures are written as .png; choose another name")
    scene.require(out)
    image, pose = pose_in_photo(photo, setup)
    if not scene.is_seen(pose, setup.intrinsics):
        raise InputError(f"{photo}: the scene would stand outside of the picture; see --at-mm")
    printed, probe, captured = read_probe(assembly, capture)
    printed.require_board(setup.board.size_mm)
    light = captured_light(captured, printed, probe, warn)
    rotation = printed.board_from_probe.rotation
    turn_rad = math.radians(scene.placement.turn_deg)
    on_board = scene.beside(printed.placed(), probe.cells, rotation, warn, drawn_rad=turn_rad)
    picture = on_board.put_into(
        image,
        on_board.lit(light, turn_rad),
        pose,
        setup.intrinsics,
        setup.response,
        lambda window: lens_rays(setup.intrinsics, _SAMPLES, window),
    )
    if np.array_equal(picture, image):
        raise InputError(
            f"{photo}: nothing of the scene would be seen, it is behind the probe or only just "
            "beyond the picture's edge; see --at-mm"
        )
    write_png(out, picture)
    tell(
        f"{out}: {len(on_board.scene.vertices)} vertices lit by {probe.cells.count} cells; "
        f"transfer coefficients in {scene.cache}"
    )


def live_scene(
    source: Path | int,
    out: Path,
    *,
    scene: VirtualScene,
    setup: Setup,
    assembly: Path,
    capture: Path | None = None,
    albedo: Float[Tensor, "3"] | None = None,
    turn_deg_per_s: float = 0.0,
    most: int | None = None,
    tell: Tell = print,
    warn: Tell = print,
) -> LiveReport:
    """Write ``out`` (.mp4, .mkv) with the scene drawn into each frame of a video or webcam.

    ``capture`` is what is known of the light at first; without it, the scene appears once half of
    the cells were seen, and ``albedo`` is the kernel's. A scene of several angles turns, in the
    film's own time, counter-clockwise seen from above; a webcam's frames are 30 a second. Ctrl-C
    ends a webcam's film, which is kept.
    """
    check_film(source, out, most)
    if not math.isfinite(turn_deg_per_s):
        raise InputError(f"a scene turns by a finite number of degrees, got {turn_deg_per_s}")
    scene.require(out)
    printed, probe, captured = read_probe(assembly, capture, albedo)
    printed.require_board(setup.board.size_mm)
    placed = printed.placed()
    on_board = scene.beside(placed, probe.cells, printed.board_from_probe.rotation, warn)
    view = PartitionLiveView(
        setup,
        placed=placed,
        probe=probe,
        scene=on_board,
        shading=RunningShading(captured.shading, captured.known),
        start_rad=math.radians(scene.placement.turn_deg),
        step_rad=math.radians(turn_deg_per_s) / film_rate(source),
    )
    return view.write(source, out, most=most, tell=tell)


def export_scene(
    scene: VirtualScene,
    out: Path,
    *,
    assembly: Path,
    capture: Path,
    exposure: float = 1.0,
    atlas_px: int | None = None,
    tell: Tell = print,
    warn: Tell = print,
) -> None:
    """``out`` (.glb): the scene in metres, the middle of its base at the origin, axes the board's.

    The ground is not in it, but the light that it throws back is. Coefficients are those of the
    vertices, or in a file beside it those of the texels of an atlas of ``atlas_px`` to a side; a
    scene that must be cut into charts for that needs xatlas.
    """
    if out.suffix.lower() != ".glb":
        raise InputError(f"{out}: scenes are written as .glb; choose another name")
    if atlas_px is not None:
        require_place(atlas_path(out))
        if scene.cache.resolve() == atlas_path(out).resolve():
            raise InputError(f"{scene.cache}: the atlas is written there; choose another cache")
    scene.require(out)
    printed, probe, captured = read_probe(assembly, capture)
    rotation = printed.board_from_probe.rotation
    light = captured_light(captured, printed, probe, warn)
    baking = Baking(probe=probe, rotation=rotation, light=light, exposure=exposure)
    if atlas_px is None:
        on_board = scene.on_board(probe.cells, rotation)
        count = len(on_board.scene.vertices)
        transfer = on_board.transfer.values[:count]
        write_relightable_glb(out, _in_metres(on_board.scene, scene.placement), transfer, baking)
        tell(f"{out}: {count} vertices with {probe.cells.count} coefficients each")
        return
    thing = scene.placement.placed(read_scene(scene.mesh, scene.albedo))
    try:
        atlas = Atlas.of_file(thing, atlas_px)
    except UnusableLayout as reason:
        tell(f"{reason}; doing so")
        atlas = Atlas.of_charts(thing, atlas_px)
    transfer = _texel_transfer(scene, thing, atlas, probe.cells, rotation)
    write_relightable_atlas(out, _in_metres(thing, scene.placement), atlas, transfer.values, baking)
    tell(
        f"{out}, {atlas_path(out)}: {len(transfer)} texels of {atlas_px} x {atlas_px} with "
        f"{probe.cells.count} coefficients each"
    )


def _texel_transfer(
    scene: VirtualScene, thing: Scene, atlas: Atlas, cells: Cells, rotation: Float[Tensor, "3 3"]
) -> TransferCoefficients:
    """Of the covered texels, beside the ground; kept in the scene's cache.

    Light bounces between the vertices of finer triangles than the atlas has.
    """
    fine, ground = scene.placed
    with stage_bar() as progress:
        return kept_transfer(
            scene.cache,
            in_probe_frame(Scene.joined([fine, ground.scene()]), rotation),
            cells,
            atlas.receivers(in_probe_frame(thing, rotation)),
            sampling=scene.sampling,
            workers=scene.workers,
            progress=lambda share: progress("transfer coefficients", share),
        )


def _in_metres(thing: Scene, placement: ScenePlacement) -> Scene:
    """With the middle of its base at the origin."""
    place = torch.tensor([placement.x_mm, placement.y_mm, placement.z_mm], dtype=torch.float64)
    to_metres = torch.eye(4, dtype=torch.float64)
    to_metres[:3, :3] *= _METRES
    to_metres[:3, 3] = -_METRES * place
    return replace(thing, uv=None, texture=None).placed(to_metres)
