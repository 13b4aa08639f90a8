"""A virtual scene with its light and its transfer coefficients as a .glb file."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from skylight.app.partition_relight import VirtualScene, captured_light, read_probe
from skylight.errors import InputError
from skylight.probes.partitions.export import write_relightable_glb

Tell = Callable[[str], None]
_METRES = 0.001  # of a millimetre


def export_scene(
    scene: VirtualScene,
    out: Path,
    *,
    assembly: Path,
    capture: Path,
    exposure: float = 1.0,
    tell: Tell = print,
    warn: Tell = print,
) -> None:
    """``out`` (.glb): the scene in metres, the middle of its base at the origin, axes the board's.

    The ground is not in it, but the light that it throws back is.

    Raises
    ------
    InputError
        A file cannot be used.
    """
    if out.suffix.lower() != ".glb":
        raise InputError(f"{out}: scenes are written as .glb; choose another name")
    standing, probe, captured = read_probe(assembly, capture)
    light = captured_light(captured, standing, probe, warn)
    rotation = torch.from_numpy(standing.rotation)
    on_board = scene.on_board(probe.cells, rotation)
    stand = scene.stand
    to_metres = torch.eye(4, dtype=torch.float64)
    to_metres[:3, :3] *= _METRES
    place = torch.tensor([stand.x_mm, stand.y_mm, stand.z_mm], dtype=torch.float64)
    to_metres[:3, 3] = -_METRES * place
    thing = on_board.scene
    write_relightable_glb(
        out,
        replace(thing, uv=None, texture=None).placed(to_metres),
        on_board.transfer.values[: len(thing.vertices)],
        light,
        probe=probe,
        rotation=rotation,
        exposure=exposure,
    )
    tell(f"{out}: {len(thing.vertices)} vertices with {probe.cells.count} coefficients each")
