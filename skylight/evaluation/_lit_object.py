"""The transport matrix of a mesh in front of a camera."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation._run import mesh_files
from skylight.sphere._frame import DirectionGrid
from skylight.transport._cameras import Camera
from skylight.transport._matrix import TransportMatrix, diffuse_transport
from skylight.transport._mesh import read_mesh
from skylight.transport._rays import Raycaster
from skylight.transport._render import GBuffer, rasterize

MESH = "stanford_dragon.ply"
PIXELS = 1477  # rows of T in the thesis' Fig. 6.7
HEIGHT = 96  # of the picture that pixels are taken from
SHOWN_HEIGHT = 80  # of the picture for people
_FIELD = 0.55  # tan of half the field of view
_FILLED = 0.92  # of the picture, by the mesh


@dataclass(frozen=True, kw_only=True)
class LitObject:
    """A diffuse mesh of albedo 1; directions are those of the mesh's own world, +Y up.

    ``buffer`` is all that the camera sees, ``chosen`` the covered pixels whose shading is observed,
    spread evenly.
    """

    raycaster: Raycaster
    buffer: GBuffer
    chosen: Tensor

    def transport(self, grid: DirectionGrid) -> TransportMatrix:
        """T of the chosen pixels, self-occlusion included."""
        return self._transport(self.chosen, grid)

    def full_transport(self, grid: DirectionGrid) -> TransportMatrix:
        """T of all covered pixels, for pictures."""
        return self._transport(torch.arange(len(self.buffer)), grid)

    def _transport(self, rows: Tensor, grid: DirectionGrid) -> TransportMatrix:
        g = self.buffer
        return diffuse_transport(
            g.origins[rows], g.normals[rows], g.geometric_normals[rows], self.raycaster, grid
        )


@cache
def lit_object(data: Path, *, pixels: int = PIXELS, height: int = HEIGHT) -> LitObject:
    """The dragon, or another mesh of the data's folder ``meshes``; once per process.

    The camera stands before its middle, looks along -Z and sees all of it, ``height`` rows by 4/3
    as many columns.
    """
    (path,) = mesh_files(data, [MESH])
    vertices, faces = read_mesh(path)
    width = height * 4 // 3
    focal = height / (2 * _FIELD)
    camera = Camera(focal_px=focal, width=width, height=height, center_px=(width / 2, height / 2))
    vertices = _placed(vertices, half_height=_FIELD, half_width=_FIELD * width / height)
    raycaster = Raycaster(vertices, faces)
    buffer = rasterize(camera, vertices, faces, raycaster)
    if len(buffer) < pixels:
        raise InputError(
            f"{path} covers {len(buffer)} of {height}x{width} pixels, fewer than the {pixels} "
            "asked for: ask for fewer or make the picture larger"
        )
    chosen = torch.linspace(0, len(buffer) - 1, pixels, dtype=torch.float64).round().long()
    return LitObject(raycaster=raycaster, buffer=buffer, chosen=chosen)


def _placed(
    vertices: Float[Tensor, "n 3"], *, half_height: float, half_width: float
) -> Float[Tensor, "n 3"]:
    """The mesh of unit depth moved along -Z until its front fits the picture."""
    low, high = vertices.amin(0), vertices.amax(0)
    centred = (vertices - (low + high) / 2) / (high - low)[2]
    extent = centred.amax(0)
    near = max(float(extent[0]) / half_width, float(extent[1]) / half_height) / _FILLED
    centred[:, 2] -= near + float(extent[2])
    return centred
