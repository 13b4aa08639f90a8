"""Voxel models lit by a captured lightmap, in a photograph or as a .glb; files to files."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.io._files import write_png
from skylight.probes._capture import pose_in_photo
from skylight.probes.cameras._drawing import composite, lens_rays
from skylight.probes.cameras._files import Setup
from skylight.probes.voxel._interreflection import GlobalReconstruction
from skylight.probes.voxel._lightmap import Lightmap, load_lightmap
from skylight.probes.voxel._model import VoxelModel, read_voxels
from skylight.probes.voxel._reconstruct import DirectReconstruction, SlotReconstruction
from skylight.probes.voxel._relight import VoxelRenderer, write_glb
from skylight.work._progress import Tell

Reconstruction = Literal["direct", "global"]
SAMPLES = 3  # along each side of a pixel


@dataclass(frozen=True, kw_only=True)
class VoxelPlacement:
    """Position of a virtual model on the board (the middle of its base), and its voxels' size."""

    x_mm: float
    z_mm: float
    y_mm: float = 0.0
    voxel_mm: float = 5.0

    def __post_init__(self) -> None:
        numbers = (self.x_mm, self.y_mm, self.z_mm, self.voxel_mm)
        if not all(map(math.isfinite, numbers)) or self.voxel_mm <= 0:
            raise InputError(
                f"a place in finite mm and voxels above 0 mm are needed, got {numbers}"
            )

    def matrix(
        self, model: VoxelModel, rotation: Float[Tensor, "3 3"] | None = None
    ) -> Float[Tensor, "4 4"]:
        """From the model's cells to millimetres of the board.

        The model stands parallel to the probe, which is turned by ``rotation`` on the board: its
        light is known for those six orientations.
        """
        x, _, z = model.occupied.shape
        turn = torch.eye(3, dtype=torch.float64) if rotation is None else rotation.double()
        base = torch.tensor([x / 2, 0, z / 2], dtype=torch.float64)
        out = torch.eye(4, dtype=torch.float64)
        out[:3, :3] = self.voxel_mm * turn
        out[:3, 3] = torch.tensor([self.x_mm, self.y_mm, self.z_mm], dtype=torch.float64)
        out[:3, 3] -= out[:3, :3] @ base
        return out


def reconstruction_for(
    lightmap: Lightmap, kind: Reconstruction, albedo: float
) -> SlotReconstruction:
    """The weights that complete what was captured."""
    if kind == "direct":
        return DirectReconstruction(lightmap.known)
    if kind == "global":
        return GlobalReconstruction(lightmap.known, albedo=albedo)
    raise InputError(f"reconstruction {kind!r}: choose direct or global")


def turned(model: VoxelModel, turns: str) -> VoxelModel:
    """Quarter turns as users write them: "y1" is one about +Y, "x2,y3" two about +X, then three."""
    for turn in filter(None, turns.split(",")):
        found = re.fullmatch(r"([a-z])(-?[0-9]{1,3})", turn)
        if found is None:
            raise InputError(f"turn {turn!r}: write an axis and how many quarters, such as y1")
        model = model.turned(found[1], int(found[2]))
    return model


def render_voxels(
    model: Path,
    lightmap: Path,
    out: Path,
    *,
    kind: Reconstruction = "global",
    albedo: float = 0.8,
    resolution: int = 32,
    turns: str = "",
    placement: VoxelPlacement,
    photo: Path | None = None,
    setup: Setup | None = None,
    tell: Tell = print,
) -> None:
    """``out``: a .glb of the lit model, or a .png of it in ``photo``.

    Raises
    ------
    InputError
        A file cannot be used; a photo without the camera's files, or without the board in view.
    """
    if out.suffix.lower() not in (".glb", ".png"):
        raise InputError(f"{out}: write a .glb of the model, or a .png of it in a photo")
    if (out.suffix.lower() == ".png") != (photo is not None):
        raise InputError("a .png needs a photo with the board, and a .glb has no use for one")
    voxels = turned(read_voxels(model, resolution=resolution), turns)
    captured = load_lightmap(lightmap)
    completed = reconstruction_for(captured, kind, albedo).complete(captured)
    if photo is None:
        write_glb(out, voxels, completed, voxel_size=placement.voxel_mm / 1000)
    else:
        if setup is None:
            raise InputError("a photo needs the camera that took it, and the board in it")
        write_png(out, drawn_into(photo, voxels, completed, setup, placement))
    tell(f"{out}: {len(voxels)} voxels lit from {int(captured.known.sum())} captured slots")


def drawn_into(
    photo: Path, model: VoxelModel, lightmap: Lightmap, setup: Setup, placement: VoxelPlacement
) -> UInt8[np.ndarray, "h w 3"]:
    """The photo with the model standing in it, as codes of the camera's own response."""
    image, pose = pose_in_photo(photo, setup)
    renderer = VoxelRenderer(model, placement.matrix(model, lightmap.rotation))
    window = renderer.window(pose, setup.intrinsics)
    drawing = renderer.draw(lightmap, lens_rays(setup.intrinsics, SAMPLES, window), pose)
    if not bool((drawing.alpha > 0).any()):
        raise InputError(f"{photo}: the model would stand outside of the picture; see --at-mm")
    return composite(image, drawing, setup.response, window)
