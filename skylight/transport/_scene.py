"""A fixed evaluation scene with shading and cast shadows, traced and shipped.

What has to be traced of it comes with skylight as a file (:class:`TracedScene`), so that an
:class:`EvaluationScene` is there at once.
"""

import io
import lzma
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.nn.functional import grid_sample, normalize

from skylight.errors import AssetError
from skylight.io._atomic import atomic_path
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from skylight.transport._cameras import Camera
from skylight.transport._matrix import SeenDirections, TransportMatrix, visibility
from skylight.transport._rays import Raycaster
from skylight.transport._render import CoveredPixels, GBuffer, rasterize, reflection_weights

DATA = Path(__file__).parent / "data"


@dataclass(frozen=True, kw_only=True)
class TracedScene:
    """What has to be traced for an :class:`EvaluationScene`: its pixels and what they see.

    ``visible`` tells which directions of the grid are free, wherever they are above the normal's
    horizon: bits, eight pixels of a direction a byte (:meth:`seen_by` unpacks some). ``mirrored``
    is where the metal's pixels mirror to.
    """

    height: int
    grid_height: int
    diffuse: CoveredPixels
    normals: Float[Tensor, "m 3"]
    on_ground: Bool[Tensor, " m"]
    visible: UInt8[np.ndarray, "n bytes"]
    metal: CoveredPixels
    mirrored: Float[Tensor, "k 3"]

    @property
    def path(self) -> Path:
        """Of the file in the package."""
        return shipped_path(self.height, self.grid_height)

    def seen_by(self, first: int, count: int) -> UInt8[Tensor, "n b"]:
        """1 where a direction is free for so many pixels from ``first`` on, a multiple of 8."""
        some = self.visible[:, first // 8 : -(-(first + count) // 8)]
        bits = np.unpackbits(some, axis=1)[:, : min(count, len(self.normals) - first)]
        return torch.from_numpy(bits)

    def save(self, path: Path) -> None:
        """Bits and float32 numbers, packed by LZMA."""
        arrays = {
            "layout": np.array(self.diffuse.layout),
            "matt": self.diffuse.pixels.numpy().astype(np.uint16),
            "normals": self.normals.numpy(),
            "on_ground": self.on_ground.numpy(),
            "visible": self.visible,
            "metal": self.metal.pixels.numpy().astype(np.uint16),
            "mirrored": self.mirrored.numpy(),
        }
        packed = io.BytesIO()
        np.savez(packed, **arrays)
        with atomic_path(path) as temporary:
            temporary.write_bytes(lzma.compress(packed.getvalue()))

    @staticmethod
    def load(path: Path) -> "TracedScene":
        """:class:`AssetError` for a file that is damaged."""
        try:
            arrays = np.load(io.BytesIO(lzma.decompress(path.read_bytes())))
            found = {name: torch.from_numpy(arrays[name]) for name in ("normals", "mirrored")}
            layout = tuple(arrays["layout"].tolist())
            return TracedScene(
                height=layout[0],
                grid_height=round((len(arrays["visible"]) / 2) ** 0.5),
                diffuse=_traced_pixels(layout, arrays["matt"]),
                on_ground=torch.from_numpy(arrays["on_ground"]),
                visible=np.ascontiguousarray(arrays["visible"]),
                metal=_traced_pixels(layout, arrays["metal"]),
                **found,
            )
        except (OSError, ValueError, KeyError, EOFError, lzma.LZMAError) as error:
            raise AssetError(f"{path}: damaged ({error}); reinstall skylight") from error


def _traced_pixels(layout: tuple[int, int], pixels: np.ndarray) -> CoveredPixels:
    return CoveredPixels(layout=layout, pixels=torch.from_numpy(pixels.astype(np.int64)))


def shipped_path(height: int, grid_height: int) -> Path:
    """Where the traced scene of a size is, if it is one of those that come with skylight."""
    return DATA / f"scene_{height}_{grid_height}.npz.xz"


def scene_camera(height: int) -> Camera:
    """It stays level, and looks down on the scene by a principal point near the top edge."""
    width = height * 4 // 3
    return Camera(
        focal_px=1.3 * height, width=width, height=height, center_px=(width / 2, 0.08 * height)
    )


def trace_scene(height: int, grid_height: int, *, workers: int = 1) -> TracedScene:
    """The scene from its camera, with the directions from which each diffuse pixel is lit."""
    camera, grid = scene_camera(height), DirectionGrid.latlong(grid_height)
    diffuse, raycaster, on_ground = diffuse_surface(camera)
    free = visibility(diffuse.origins, diffuse.geometric_normals, raycaster, grid, workers=workers)
    below = diffuse.normals @ grid.directions.T <= 0  # as good as free, and packed better so
    from skylight.transport._scene_meshes import metal_mesh  # takes trimesh, slow to import

    vertices, faces = metal_mesh()
    metal = rasterize(camera, vertices, faces, Raycaster(vertices, faces))
    return TracedScene(
        height=height,
        grid_height=grid_height,
        diffuse=_pixels(diffuse),
        normals=diffuse.normals.float(),
        on_ground=on_ground,
        # a direction's pixels side by side: neighbours are alike, for whatever packs the file
        visible=np.packbits((free | below).T.numpy(), axis=1),
        metal=_pixels(metal),
        mirrored=_mirrored(metal).float(),
    )


def diffuse_surface(camera: Camera) -> tuple[GBuffer, Raycaster, Bool[Tensor, " m"]]:
    """What the camera sees of the diffuse scene, and which pixels are of the ground."""
    from skylight.transport._scene_meshes import diffuse_mesh  # takes trimesh, slow to import

    vertices, faces, of_ground = diffuse_mesh()
    raycaster = Raycaster(vertices, faces)
    diffuse = rasterize(camera, vertices, faces, raycaster)
    return diffuse, raycaster, of_ground[diffuse.faces]


def _pixels(surface: GBuffer) -> CoveredPixels:
    return CoveredPixels(layout=surface.layout, pixels=surface.pixels)


def _mirrored(metal: GBuffer) -> Float[Tensor, "k 3"]:
    """The direction that each point of the metal mirrors."""
    view = normalize(metal.positions, dim=1)
    cosine = (view * metal.normals).sum(1, keepdim=True)
    return view - 2 * cosine * metal.normals


GROUND_ALBEDO = 0.5
OBJECT_ALBEDO = 0.7
METAL_REFLECTANCE = 0.9
METAL_ROUGHNESS = 0.25
_PIXELS = 64  # whose rows are computed together


@dataclass(frozen=True)
class EvaluationScene:
    """A ball, a ring, a block and a rabbit on a grey ground, traced for one camera.

    Light is a full lat-long map, resized to ``grid``, keeping its energy. Shading is computed from
    what each pixel sees, block by block: as long as making a matrix of 170 MB takes, again for each
    light. Memory: a bit for each pixel and direction, 5 MB.
    """

    traced: TracedScene

    @property
    def grid(self) -> DirectionGrid:
        return DirectionGrid.latlong(self.traced.grid_height)

    @property
    def camera(self) -> Camera:
        return scene_camera(self.traced.height)

    @property
    def diffuse(self) -> CoveredPixels:
        """Pixels of the diffuse scene; ``metal`` those of a metal ball and ring without ground."""
        return self.traced.diffuse

    @property
    def metal(self) -> CoveredPixels:
        return self.traced.metal

    @property
    def albedo(self) -> Float[Tensor, "m 3"]:
        albedo = torch.where(self.traced.on_ground, GROUND_ALBEDO, OBJECT_ALBEDO)
        return albedo[:, None].expand(-1, 3)

    @property
    def transport(self) -> TransportMatrix:
        """The diffuse scene's, made anew by every call: 4 bytes for each pixel and direction."""
        seen = self.traced.seen_by(0, len(self.traced.normals)).T.bool()
        sight = SeenDirections(visible=seen, normals=self.traced.normals, grid=self.grid)
        return sight.transport()

    def shade(self, environment: EnvironmentMap) -> Float[Tensor, "m 3"]:
        """Direct light at the diffuse scene's pixels, albedo * T l."""
        grid, traced = self.grid, self.traced
        irradiance = self._light(environment) * (grid.solid_angles / torch.pi).float()[:, None]
        directions, shading = grid.directions.float(), []
        for first in range(0, len(traced.normals), _PIXELS):
            cosine = directions @ traced.normals[first : first + _PIXELS].T
            cosine.clamp_(min=0).mul_(traced.seen_by(first, _PIXELS))
            shading.append(irradiance.T @ cosine)
        return self.albedo * torch.cat(shading, 1).T

    def relight(self, environment: EnvironmentMap) -> Float[Tensor, "h w 3"]:
        """Picture of the diffuse scene; where it ends, the environment itself is seen."""
        return self.diffuse.image(self.shade(environment), self._background(environment))

    def relight_specular(self, environment: EnvironmentMap) -> Float[Tensor, "h w 3"]:
        """Picture of the metal objects before the environment, without shadows."""
        light, alpha = self._light(environment), METAL_ROUGHNESS**2
        reflected = METAL_REFLECTANCE * torch.cat(
            [
                reflection_weights(some, self.grid, alpha) @ light
                for some in self.traced.mirrored.split(_PIXELS)
            ]
        )
        return self.metal.image(reflected, self._background(environment))

    def _light(self, environment: EnvironmentMap) -> Float[Tensor, "n 3"]:
        if environment.is_sky:
            raise ValueError("a sky alone leaves the ground unknown: add one with .with_ground()")
        if environment.layout != self.grid.layout:
            environment = environment.resize(self.traced.grid_height)
        return environment.flat.to(self.traced.normals)

    def _background(self, environment: EnvironmentMap) -> Float[Tensor, "h w 3"]:
        height, width = environment.layout
        row, column = pixel_from_direction(self.camera.rays(), height, width)
        # grid_sample's -1 and 1 are the picture's borders; the map's seam is behind the camera
        where = torch.stack([(column + 0.5) / width, (row + 0.5) / height], dim=-1) * 2 - 1
        picture = grid_sample(
            environment.radiance.float().permute(2, 0, 1)[None],
            where.float()[None, None],
            padding_mode="border",
            align_corners=False,
        )
        return picture[0, :, 0].T.reshape(self.camera.height, self.camera.width, 3)


@cache
def evaluation_scene(height: int = 72, grid_height: int = 64) -> EvaluationScene:
    """The scene at ``height`` x 4/3 ``height`` pixels over a full lat-long grid; made once.

    Sizes that do not come with skylight are traced.
    """
    path = shipped_path(height, grid_height)
    if path.exists():
        return EvaluationScene(TracedScene.load(path))

    return EvaluationScene(trace_scene(height, grid_height))
