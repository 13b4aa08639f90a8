"""A box on the board's plane, its ground and a light, for tests of what is drawn."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import torch
import trimesh

from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.relight import _gather
from skylight.probes.partitions.relight._atlas import refined
from skylight.probes.partitions.relight._composite import SceneOnBoard, board_transfer
from skylight.probes.partitions.relight._gather import Ground
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import TransferSampling
from tests.probes.partitions.shapes import solid

F64 = torch.float64
STILL = torch.eye(3, dtype=F64)
COLOURS = torch.tensor([[0.9, 0.8, 0.7], [0.1, 0.2, 0.3]]).repeat(7, 1)


def turn_about_y(radians: float) -> torch.Tensor:
    c, s = torch.tensor(radians, dtype=F64).cos(), torch.tensor(radians, dtype=F64).sin()
    return torch.stack([torch.stack([c, 0 * c, s]), STILL[1], torch.stack([-s, 0 * c, c])])


def affine(linear: torch.Tensor, shift: tuple[float, float, float]) -> torch.Tensor:
    out = torch.eye(4, dtype=F64)
    out[:3, :3], out[:3, 3] = linear, torch.tensor(shift, dtype=F64)
    return out


def box(side: float = 20.0) -> Scene:
    """A cube that stands on y = 0 at the origin."""
    cube = trimesh.creation.box((side, side, side))
    cube.apply_translation((0, side / 2, 0))
    return refined(solid(cube), side / 4)


@cache
def fourteen() -> Cells:
    return Cells.of(named_design("14d"))


def standing(
    scene: Scene, rotation: torch.Tensor = STILL, *, rays: int = 32, bounces: int = 2, **real
) -> SceneOnBoard:
    ground = Ground.under(scene)
    transfer = board_transfer(
        Path(mkdtemp()) / "t.npz",
        scene,
        ground,
        fourteen(),
        rotation,
        sampling=TransferSampling(rays=rays, bounces=bounces),
    )
    return SceneOnBoard(scene, ground, transfer, fourteen(), rotation, **real)


def box_on_board() -> SceneOnBoard:
    return _box_on_ground(_gather.ACROSS)


@cache
def _box_on_ground(_across: int) -> SceneOnBoard:
    """One for each density of the ground, which ``coarse_ground`` changes."""
    return standing(box(), rays=128)
