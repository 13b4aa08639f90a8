"""A virtual scene with its light and its transfer coefficients as a .glb file."""

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._atomic import require_place
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._relight_files import VirtualScene, captured_light, read_probe
from skylight.probes.partitions.relight._atlas import Atlas, UnusableLayout
from skylight.probes.partitions.relight._export import (
    atlas_path,
    write_relightable_atlas,
    write_relightable_glb,
)
from skylight.probes.partitions.relight._scene import Scene, read_scene
from skylight.probes.partitions.relight._transfer import TransferCoefficients, kept_transfer
from skylight.work._progress import Tell, stage_bar

_METRES = 0.001  # of a millimetre


@dataclass(frozen=True, kw_only=True, eq=False)
class _Captured:
    probe: PartitionProbe
    rotation: Float[Tensor, "3 3"]
    light: Float[Tensor, "n 3"]
    exposure: float


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
    vertices, or in a file beside it those of the texels of an atlas of ``atlas_px`` to a side.

    Raises
    ------
    InputError
        A file cannot be used.
    DependencyError
        The scene must be cut into charts, and xatlas is not installed.
    """
    if out.suffix.lower() != ".glb":
        raise InputError(f"{out}: scenes are written as .glb; choose another name")
    if atlas_px is not None:
        require_place(atlas_path(out))
        if scene.cache.resolve() == atlas_path(out).resolve():
            raise InputError(f"{scene.cache}: the atlas is written there; choose another cache")
    scene.require(out)
    printed, probe, captured = read_probe(assembly, capture)
    light = captured_light(captured, printed, probe, warn)
    rotation = printed.board_from_probe.rotation
    lit = _Captured(probe=probe, rotation=rotation, light=light, exposure=exposure)
    if atlas_px is None:
        _export_vertices(scene, out, lit, tell)
    else:
        _export_texels(scene, out, lit, atlas_px, tell)


def _export_vertices(scene: VirtualScene, out: Path, lit: _Captured, tell: Tell) -> None:
    on_board = scene.on_board(lit.probe.cells, lit.rotation)
    thing = on_board.scene
    write_relightable_glb(
        out,
        _in_metres(thing, scene),
        on_board.transfer.values[: len(thing.vertices)],
        lit.light,
        probe=lit.probe,
        rotation=lit.rotation,
        exposure=lit.exposure,
    )
    tell(f"{out}: {len(thing.vertices)} vertices with {lit.probe.cells.count} coefficients each")


def _export_texels(scene: VirtualScene, out: Path, lit: _Captured, size: int, tell: Tell) -> None:
    thing = scene.placement.placed(read_scene(scene.mesh, scene.albedo))
    atlas = _laid_out(thing, size, tell)
    transfer = _texel_transfer(scene, thing, atlas, lit.probe.cells, lit.rotation)
    write_relightable_atlas(
        out,
        _in_metres(thing, scene),
        atlas,
        transfer.values,
        lit.light,
        probe=lit.probe,
        rotation=lit.rotation,
        exposure=lit.exposure,
    )
    tell(
        f"{out}, {atlas_path(out)}: {len(transfer)} texels of {size} x {size} with "
        f"{lit.probe.cells.count} coefficients each"
    )


def _laid_out(thing: Scene, size: int, tell: Tell) -> Atlas:
    """By the file's texture coordinates where they can be used."""
    try:
        return Atlas.of_file(thing, size)
    except UnusableLayout as reason:
        tell(f"{reason}; doing so")
        return Atlas.of_charts(thing, size)


def _texel_transfer(
    scene: VirtualScene, thing: Scene, atlas: Atlas, cells: Cells, rotation: Float[Tensor, "3 3"]
) -> TransferCoefficients:
    """Of the covered texels, beside the ground; kept in the scene's cache.

    Light bounces between the vertices of finer triangles than the atlas has.
    """
    to_probe = torch.eye(4, dtype=torch.float64)
    to_probe[:3, :3] = rotation.double().T
    fine, ground = scene.placed
    with stage_bar() as progress:
        return kept_transfer(
            scene.cache,
            Scene.joined([fine, ground.scene()]).placed(to_probe),
            cells,
            atlas.receivers(thing.placed(to_probe)),
            sampling=scene.sampling,
            workers=scene.workers,
            progress=lambda share: progress("transfer coefficients", share),
        )


def _in_metres(thing: Scene, scene: VirtualScene) -> Scene:
    """With the middle of its base at the origin."""
    placement = scene.placement
    to_metres = torch.eye(4, dtype=torch.float64)
    to_metres[:3, :3] *= _METRES
    place = torch.tensor([placement.x_mm, placement.y_mm, placement.z_mm], dtype=torch.float64)
    to_metres[:3, 3] = -_METRES * place
    return replace(thing, uv=None, texture=None).placed(to_metres)
