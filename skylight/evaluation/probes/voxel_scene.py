"""Voxel models rendered from a probe's lightmap and by path tracing (thesis, 3.6.1)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.cameras.drawing import camera_rays, looking_at
from skylight.probes.voxel.faces import NORMALS, VoxelFaces, exposed_faces
from skylight.probes.voxel.lightmap import SIZE, Lightmap
from skylight.probes.voxel.model import VoxelModel, star_probe, voxelise
from skylight.probes.voxel.relight.render import VoxelRenderer
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.rigid_transform import RigidTransform
from skylight.transport.camera import Camera
from skylight.transport.indirect.path_tracer import DiffuseScene, Sampling, shade

ALBEDO = 0.8
PIXELS = 160
MODELS = ("stanford_bunny.ply", "stanford_dragon.ply", "stanford_buddha.ply")
RESOLUTION = 24  # voxels along the longest side
VIEWS_DEG = ((35.0, 25.0), (215.0, 25.0))  # azimuth and elevation


@dataclass(frozen=True, kw_only=True)
class View:
    """One picture of a model: which pixels show it, and which points of it they show."""

    mask: Bool[Tensor, "h w"]
    points: Float[Tensor, "m 3"]
    normals: Float[Tensor, "m 3"]


@dataclass(frozen=True, kw_only=True)
class VoxelScene:
    """A model of one albedo, and how it is looked at."""

    model: VoxelModel
    albedo: float
    renderer: VoxelRenderer
    scene: DiffuseScene
    poses: tuple[RigidTransform, ...]
    camera: Camera

    @staticmethod
    def of(
        model: VoxelModel,
        *,
        albedo: float = ALBEDO,
        views_deg: Sequence[tuple[float, float]] = VIEWS_DEG,
    ) -> "VoxelScene":
        """From azimuths and elevations, filling the picture."""
        renderer = VoxelRenderer(model)
        vertices, triangles = exposed_faces(model).triangles()
        size = torch.tensor(model.occupied.shape, dtype=torch.float64)
        middle, distance = size / 2, 2.0 * float(size.norm())
        focal = 0.95 * PIXELS * distance / float(size.norm())
        poses = []
        for azimuth, elevation in torch.tensor(views_deg, dtype=torch.float64).deg2rad():
            flat = elevation.cos()
            offset = torch.stack([flat * azimuth.sin(), elevation.sin(), flat * azimuth.cos()])
            poses.append(looking_at(middle + distance * offset, middle))
        return VoxelScene(
            model=model,
            albedo=albedo,
            renderer=renderer,
            scene=DiffuseScene.uniform(vertices, triangles, albedo),
            poses=tuple(poses),
            camera=Camera(
                focal_px=focal, width=PIXELS, height=PIXELS, center_px=(PIXELS / 2, PIXELS / 2)
            ),
        )

    def drawn(self, lightmap: Lightmap) -> list[Float[Tensor, "h w 3"]]:
        """By texture mapping, one ray through each pixel's centre."""
        rays = camera_rays(self.camera)
        return [self.renderer.draw(lightmap, rays, pose).radiance for pose in self.poses]

    def traced(
        self, environment: EnvironmentMap, sampling: Sampling, seed: int
    ) -> tuple[list[Float[Tensor, "h w 3"]], list[Bool[Tensor, "h w"]], float]:
        """(path-traced pictures, where the model is, standard error relative to the mean)."""
        views = [self._view(pose) for pose in self.poses]
        found = shade(
            torch.cat([view.points for view in views]),
            torch.cat([view.normals for view in views]),
            self.scene,
            environment,
            albedo=self.albedo,
            sampling=sampling,
            generator=torch.Generator().manual_seed(seed),
        )
        noise = float(found.standard_error.mean() / found.mean.mean())
        pictures = []
        for view, shades in zip(
            views, found.mean.split([len(view.points) for view in views]), strict=True
        ):
            picture = torch.zeros(*view.mask.shape, 3)
            picture[view.mask] = shades.float()
            pictures.append(picture)
        return pictures, [view.mask for view in views], noise

    def _view(self, pose: RigidTransform) -> View:
        back = pose.inverse()
        eye, rays = back.translation, back.directions(camera_rays(self.camera).reshape(-1, 3))
        hits = self.scene.raycaster.intersect(eye.expand(len(rays), 3), rays)
        seen = hits.face >= 0
        return View(
            mask=seen.reshape(PIXELS, PIXELS),
            points=eye + hits.distance[seen, None] * rays[seen],
            normals=self.scene.normals[hits.face[seen]].double(),
        )


@cache
def voxel_scene(mesh: Path) -> VoxelScene:
    """A mesh in :data:`RESOLUTION` voxels along its longest side; once per process."""
    return VoxelScene.of(voxelise(mesh, RESOLUTION))


def baked(
    size: int,
    environment: EnvironmentMap,
    sampling: Sampling,
    seed: int,
    *,
    albedo: float = ALBEDO,
) -> Lightmap:
    """The lightmap of a perfect capture of the N-probe: path-traced shading of its faces.

    Where several faces have one configuration, their mean.
    """
    faces: VoxelFaces = exposed_faces(star_probe(size))
    points = faces.points(SIZE)
    normals = torch.from_numpy(NORMALS).double()[faces.orientation]
    found = shade(
        points.reshape(-1, 3),
        normals.repeat_interleave(SIZE * SIZE, 0),
        DiffuseScene.uniform(*faces.triangles(), albedo),
        environment,
        albedo=albedo,
        sampling=sampling,
        generator=torch.Generator().manual_seed(seed),
    ).mean.reshape(len(faces), SIZE, SIZE, 3)
    total = torch.zeros(192, SIZE, SIZE, 3, dtype=found.dtype)
    total.index_add_(0, faces.slot, found)
    count = faces.counts()
    radiance = total / count.clamp(min=1).reshape(-1, 1, 1, 1)
    known = (count > 0).float()
    return Lightmap(
        radiance=radiance.reshape(6, 32, SIZE, SIZE, 3).float(), coverage=known, confidence=known
    )
