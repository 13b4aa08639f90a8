"""A scene of models on a ground plane, relit by partition probes and path traced (thesis, 4.7)."""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import not_installed
from skylight.probes.cameras._drawing import looking_at
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions.relight._atlas import Receivers, refined
from skylight.probes.partitions.relight._composite import Relighting
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import TransferSampling, transfer_coefficients
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import rotation_about
from skylight.transport._cameras import Camera
from skylight.transport._mesh import joined_mesh
from skylight.transport._path_tracer import DiffuseScene, Sampling, radiosity_transfer, shade
from skylight.transport._render import GBuffer, rasterize

ALBEDO = 0.8
WIDTH = 192
_SHAPE = 7 / 12  # of a picture: its height over its width
MODELS = ("stanford_bunny.ply", "stanford_dragon.ply", "spot.ply")
_TURN_DEG = {"spot.ply": 150.0}  # about the vertical
DEGREE = 4
_FACES = 12_000  # of each model
_APART = 1.0  # between the models' middles; each is 1 high
_GROUND, _LONGEST_EDGE = 6.0, 0.2  # half the ground's side, and the edges of its triangles
_ELEVATION_RAD, _DISTANCE, _VIEW = 0.45, 8.0, 3.6  # of the camera; width of what it sees
_BOUNCES = 8
_UP = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class PartitionScene:
    """What the camera sees of ``scene``: ``points``, in the pixels of ``gbuffer``."""

    scene: Scene
    gbuffer: GBuffer
    points: Receivers

    @cached_property
    def _diffuse(self) -> DiffuseScene:
        return DiffuseScene.uniform(self.scene.vertices, self.scene.faces, ALBEDO)

    def picture(self, radiance: Float[Tensor, "m 3"]) -> Float[Tensor, "h w 3"]:
        return self.gbuffer.image(radiance)

    def relighting(self, design: ProbeDesign, rays: int, seed: int) -> Relighting:
        """From the light of a design's cells, with all bounces."""
        sampling = TransferSampling(rays=rays, bounces=_BOUNCES, seed=seed)
        return Relighting(
            transfer_coefficients(self.scene, Cells.of(design), self.points, sampling=sampling)
        )

    def harmonic_transfer(self, samples: int, seed: int) -> Float[Tensor, "m k"]:
        """From the light's harmonics up to degree 4, path traced."""
        return radiosity_transfer(
            self.points.positions,
            self.points.normals,
            self._diffuse,
            degree=DEGREE,
            albedo=ALBEDO,
            sampling=Sampling(samples=samples, bounces=_BOUNCES),
            generator=torch.Generator().manual_seed(seed),
        ).mean

    def lit_sphere(self, light: EnvironmentMap) -> Float[Tensor, "m 3"]:
        """A ball's shading at each point's normal: direct light without shadows."""
        arriving = light.flat.double() * light.grid.solid_angles[:, None]
        found = [
            (some @ light.grid.directions.T).clamp(min=0) @ arriving
            for some in self.points.normals.split(2048)
        ]
        return ALBEDO / math.pi * torch.cat(found)

    def traced(
        self, light: EnvironmentMap, samples: int, seed: int
    ) -> tuple[Float[Tensor, "m 3"], float]:
        """(the path-traced reference, its standard error relative to its mean)."""
        found = shade(
            self.points.positions,
            self.points.normals,
            self._diffuse,
            light,
            albedo=ALBEDO,
            sampling=Sampling(samples=samples, bounces=_BOUNCES),
            generator=torch.Generator().manual_seed(seed),
        )
        return found.mean, float(found.standard_error.mean() / found.mean.mean())


@cache
def partition_scene(meshes: tuple[Path, ...], width: int = WIDTH) -> PartitionScene:
    """Models side by side, in a picture of so many pixels across."""
    height = round(_SHAPE * width)
    albedo = torch.full((3,), ALBEDO, dtype=torch.float64)
    parts = [_ground(albedo)]
    for i, path in enumerate(meshes):
        vertices, faces = _standing(path)
        turn = math.radians(_TURN_DEG.get(path.name, 0.0))
        vertices = vertices @ rotation_about(_UP, turn).T
        vertices[:, 0] += (i - (len(meshes) - 1) / 2) * _APART
        parts.append(Scene.of(vertices, faces, albedo))
    scene = Scene.joined(parts)
    eye = _DISTANCE * torch.tensor([0.0, math.sin(_ELEVATION_RAD), math.cos(_ELEVATION_RAD)])
    middle = torch.tensor([0.0, 0.35, 0.0])
    pose = looking_at(eye.double() + middle.double(), middle)
    camera = Camera(
        focal_px=width * _DISTANCE / _VIEW,
        width=width,
        height=height,
        center_px=(width / 2, height / 2),
    )
    seen = scene.placed(pose.matrix())
    gbuffer = rasterize(camera, seen.vertices, seen.faces, seen.raycaster)
    found, back = Receivers.seen(gbuffer, seen), pose.inverse()
    points = Receivers(
        positions=back.points(found.positions),
        normals=back.directions(found.normals),
        geometric_normals=back.directions(found.geometric_normals),
        albedo=found.albedo,
    )
    return PartitionScene(scene=scene, gbuffer=gbuffer, points=points)


def harmonic_light(light: EnvironmentMap) -> Float[Tensor, "k 3"]:
    """The map's coefficients up to degree 4."""
    return harmonics.project(light.flat.double(), light.grid, DEGREE)


def _standing(path: Path) -> tuple[Float[Tensor, "v 3"], Tensor]:
    """A mesh of fewer triangles, 1 high, its foot on the ground and its middle over the origin."""
    mesh = joined_mesh(path)
    places, triangles = np.asfortranarray(mesh.vertices), np.asfortranarray(mesh.faces)
    if len(triangles) > _FACES:
        try:
            import igl
        except ImportError as error:
            what = f"{path} has more than {_FACES} triangles, and making fewer of them"
            raise not_installed("igl", what) from error
        places, triangles, _, _ = igl.qslim(places, triangles.astype(np.int32), _FACES, False)
    places, triangles = (torch.from_numpy(np.ascontiguousarray(a)) for a in (places, triangles))
    low, high = places.amin(0), places.amax(0)
    foot = torch.stack([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    return (places - foot) / (high[1] - low[1]), triangles.long()


def _ground(albedo: Float[Tensor, "3"]) -> Scene:
    corners = torch.tensor([[-1.0, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]).double() * _GROUND
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    return refined(Scene.of(corners, faces, albedo), _LONGEST_EDGE)
