"""A fixed evaluation scene with shading and cast shadows."""

from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import grid_sample

from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import pixel_from_direction
from skylight.sphere.grid import DirectionGrid
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import CoveredPixels
from skylight.transport.matrix import SeenDirections, TransportMatrix
from skylight.transport.render import reflection_weights
from skylight.transport.scene.traced import TracedScene, scene_camera, shipped_path

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
    def matt(self) -> CoveredPixels:
        """Pixels of the matt scene; ``metal`` those of a metal ball and ring without ground."""
        return self.traced.matt

    @property
    def metal(self) -> CoveredPixels:
        return self.traced.metal

    @property
    def albedo(self) -> Float[Tensor, "m 3"]:
        albedo = torch.where(self.traced.on_ground, GROUND_ALBEDO, OBJECT_ALBEDO)
        return albedo[:, None].expand(-1, 3)

    @property
    def transport(self) -> TransportMatrix:
        """The matt scene's, made anew by every call: 4 bytes for each pixel and direction."""
        seen = self.traced.seen_by(0, len(self.traced.normals)).T.bool()
        sight = SeenDirections(visible=seen, normals=self.traced.normals, grid=self.grid)
        return sight.transport()

    def shade(self, environment: EnvironmentMap) -> Float[Tensor, "m 3"]:
        """Direct diffuse light at the matt scene's pixels, albedo * T l."""
        grid, traced = self.grid, self.traced
        irradiance = self._light(environment) * (grid.solid_angles / torch.pi).float()[:, None]
        directions, shading = grid.directions.float(), []
        for first in range(0, len(traced.normals), _PIXELS):
            cosine = directions @ traced.normals[first : first + _PIXELS].T
            cosine.clamp_(min=0).mul_(traced.seen_by(first, _PIXELS))
            shading.append(irradiance.T @ cosine)
        return self.albedo * torch.cat(shading, 1).T

    def relight(self, environment: EnvironmentMap) -> Float[Tensor, "h w 3"]:
        """Picture of the matt scene; where it ends, the environment itself is seen."""
        return self.matt.image(self.shade(environment), self._background(environment))

    def relight_glossy(self, environment: EnvironmentMap) -> Float[Tensor, "h w 3"]:
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
    from skylight.transport.scene.model import trace_scene  # trimesh is slow to import

    return EvaluationScene(trace_scene(height, grid_height))
