"""A fixed evaluation scene with shading and cast shadows."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample, normalize

from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import pixel_from_direction
from skylight.sphere.grid import DirectionGrid
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import GBuffer, rasterize
from skylight.transport.matrix import TransportMatrix, diffuse_transport
from skylight.transport.raycast import Raycaster
from skylight.transport.render import reflection_weights

GROUND_ALBEDO = 0.5
OBJECT_ALBEDO = 0.7
METAL_REFLECTANCE = 0.9
METAL_ROUGHNESS = 0.25
GROUND_Y = -1.5  # the camera is at the origin, so it stands 1.5 above the ground


@dataclass(frozen=True, kw_only=True)
class EvaluationScene:
    """A ball, a ring, a block and a rabbit on a grey ground, precomputed for one camera.

    ``transport`` and ``albedo`` give the matt scene's shading; ``mirror`` (k,n) weighs a map's
    directions for each pixel of ``metal``, a metal ball and ring without ground. Both are
    over the same full lat-long grid, to which maps are resized, keeping their energy.
    """

    camera: Camera
    matt: GBuffer
    transport: TransportMatrix
    albedo: Float[Tensor, "m 3"]
    metal: GBuffer
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
    """The scene at ``height`` x 4/3 ``height`` pixels over a full lat-long grid; built once.

    About 6000 x 8192 entries (200 MB) by default.
    """
    width = height * 4 // 3
    # The principal point near the top edge looks down on the scene while the camera stays level.
    camera = Camera(
        focal_px=1.3 * height, width=width, height=height, center_px=(width / 2, 0.08 * height)
    )
    grid = DirectionGrid.latlong(grid_height)

    vertices, faces, on_ground = _mesh(_matt_parts())
    raycaster = Raycaster(vertices, faces)
    matt = rasterize(camera, vertices, faces, raycaster)
    transport = diffuse_transport(
        matt.origins, matt.normals, matt.geometric_normals, raycaster, grid
    )
    albedo = torch.where(on_ground[matt.faces], GROUND_ALBEDO, OBJECT_ALBEDO)

    vertices, faces, _ = _mesh(_metal_parts())
    metal = rasterize(camera, vertices, faces, Raycaster(vertices, faces))
    return EvaluationScene(
        camera=camera,
        matt=matt,
        transport=transport,
        albedo=albedo[:, None].expand(-1, 3),
        metal=metal,
        mirror=_mirror(metal, grid),
    )


def _mirror(metal: GBuffer, grid: DirectionGrid) -> Float[Tensor, "k n"]:
    """A map blurred about the direction that each point of the metal mirrors."""
    view = normalize(metal.positions, dim=1)
    cosine = (view * metal.normals).sum(1, keepdim=True)
    return reflection_weights(view - 2 * cosine * metal.normals, grid, METAL_ROUGHNESS**2)


def _matt_parts() -> list:
    import trimesh.creation as make  # slow to import

    ground = make.cylinder(radius=9, height=0.02, sections=96)
    ground.apply_transform(_turned(1.5 * np.pi, axis=(1.0, 0.0, 0.0)))
    ball = make.icosphere(subdivisions=4, radius=0.42)
    ring = make.torus(0.36, 0.13, major_sections=96, minor_sections=40)
    block = make.box(extents=(0.55, 0.9, 0.55))
    block.apply_transform(_turned(0.6, axis=(0.0, 1.0, 0.0)))
    return [
        # facets, not smoothed corners, for what has true edges
        _at(_faceted(ground), (0, GROUND_Y - 0.01, -4)),
        _at(ball, (-1.1, GROUND_Y + 0.42, -3.3)),
        _at(_faceted(block), (-0.35, GROUND_Y + 0.45, -4.3)),
        *[_at(part, (0.25, GROUND_Y, -3.1)) for part in _rabbit()],
        _at(ring, (1.15, GROUND_Y + 0.49, -3.5)),
    ]


def _metal_parts() -> list:
    import trimesh.creation as make

    ring = make.torus(0.42, 0.17, major_sections=128, minor_sections=48)
    ring.apply_transform(_turned(-0.5, axis=(1.0, 1.0, 0.0)))
    ball = make.icosphere(subdivisions=5, radius=0.62)
    return [_at(ball, (-0.72, -0.95, -3.2)), _at(ring, (0.8, -0.95, -3.2))]


def _rabbit() -> list:
    """Body, head, ears, paws and tail of a sitting rabbit that looks to the left; feet at y = 0."""
    import trimesh.creation as make

    def blob(centre: tuple, radii: tuple, turn_rad: float = 0.0):
        part = make.icosphere(subdivisions=3)
        part.apply_scale(radii)
        part.apply_transform(_turned(turn_rad, axis=(0.0, 0.0, 1.0)))
        return _at(part, centre)

    return [
        blob((0.05, 0.30, 0.0), (0.34, 0.28, 0.25), turn_rad=-0.5),
        blob((-0.20, 0.66, 0.0), (0.20, 0.17, 0.16)),
        blob((-0.06, 0.95, 0.08), (0.06, 0.22, 0.04), turn_rad=-0.25),
        blob((-0.06, 0.95, -0.08), (0.06, 0.22, 0.04), turn_rad=-0.45),
        blob((-0.20, 0.08, 0.12), (0.14, 0.08, 0.07)),
        blob((-0.20, 0.08, -0.12), (0.14, 0.08, 0.07)),
        blob((0.38, 0.16, 0.0), (0.10, 0.10, 0.10)),
    ]


def _turned(angle_rad: float, axis: tuple[float, float, float]) -> np.ndarray:
    from trimesh.transformations import rotation_matrix

    return np.asarray(rotation_matrix(angle_rad, axis))


def _at(part, position: tuple):
    part.apply_translation(position)
    return part


def _faceted(part):
    part.unmerge_vertices()
    return part


def _mesh(
    parts: list,
) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"], Tensor]:
    """All parts as one mesh, and which faces are the first part's."""
    first = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([np.asarray(part.vertices) for part in parts])
    faces = np.concatenate(
        [np.asarray(part.faces) + start for part, start in zip(parts, first[:-1], strict=True)]
    )
    in_first = torch.arange(len(faces)) < len(parts[0].faces)
    return torch.from_numpy(vertices), torch.from_numpy(faces), in_first
