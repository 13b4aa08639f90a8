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
from skylight.transport.matrix import TransportMatrix
from skylight.transport.render import reflection_weights
from skylight.transport.scene.traced import TracedScene, scene_camera, shipped_path

GROUND_ALBEDO = 0.5
OBJECT_ALBEDO = 0.7
METAL_REFLECTANCE = 0.9
METAL_ROUGHNESS = 0.25


@dataclass(frozen=True, kw_only=True)
class EvaluationScene:
    """A ball, a ring, a block and a rabbit on a grey ground, precomputed for one camera.

    ``transport`` and ``albedo`` give the matt scene's shading; ``mirror`` (k,n) weighs a map's
    directions for each pixel of ``metal``, a metal ball and ring without ground. Both are
    over the same full lat-long grid, to which maps are resized, keeping their energy.
    """

    camera: Camera
    matt: CoveredPixels
    transport: TransportMatrix
    albedo: Float[Tensor, "m 3"]
    metal: CoveredPixels
    mirror: Float[Tensor, "k n"]

    def shade(self, environment: EnvironmentMap) -> Float[Tensor, "m 3"]:
        """Direct diffuse light at the matt scene's pixels, albedo * T l."""
        return self.albedo * (self.transport.matrix @ self._light(environment))

    def relight(self, environment: EnvironmentMap) -> Float[Tensor, "h w 3"]:
        """Picture of the matt scene; where it ends, the environment itself is seen."""
        return self.matt.image(self.shade(environment), self._background(environment))

    def relight_glossy(self, environment: EnvironmentMap) -> Float[Tensor, "h w 3"]:
        """Picture of the metal objects before the environment, without shadows."""
        reflected = METAL_REFLECTANCE * (self.mirror @ self._light(environment))
        return self.metal.image(reflected, self._background(environment))

    def _light(self, environment: EnvironmentMap) -> Float[Tensor, "n 3"]:
        if environment.is_sky:
            raise ValueError("a sky alone leaves the ground unknown: add one with .with_ground()")
        layout = self.transport.grid.layout
        assert layout is not None
        if environment.layout != layout:
            environment = environment.resize(layout[0])
        return environment.flat.to(self.mirror)

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

    About 6000 x 8192 entries (200 MB) by default. Sizes that do not come with skylight are traced.
    """
    path = shipped_path(height, grid_height)
    if path.exists():
        return _scene(TracedScene.load(path))
    from skylight.transport.scene.model import trace_scene  # trimesh is slow to import

    return _scene(trace_scene(height, grid_height))


def _scene(traced: TracedScene) -> EvaluationScene:
    grid = DirectionGrid.latlong(traced.grid_height)
    directions, solid = grid.directions.float(), grid.solid_angles.float()
    matrix = (traced.normals @ directions.T).clamp_(min=0).mul_(solid / torch.pi)
    albedo = torch.where(traced.on_ground, GROUND_ALBEDO, OBJECT_ALBEDO)
    return EvaluationScene(
        camera=scene_camera(traced.height),
        matt=traced.matt,
        transport=TransportMatrix(matrix=matrix.mul_(traced.visible), grid=grid),
        albedo=albedo[:, None].expand(-1, 3),
        metal=traced.metal,
        mirror=reflection_weights(traced.mirrored, grid, METAL_ROUGHNESS**2),
    )
