"""Objects that know about light, and lights for them."""

import numpy as np
import torch
import trimesh

from skylight.probes._encoder import SurfaceTransfer, surface_points, surface_transfer
from skylight.probes.partitions.relight._scene import Scene
from skylight.sphere._frame import DirectionGrid

GRID = DirectionGrid.latlong(16)


def solid(mesh: trimesh.Trimesh, albedo=(0.6, 0.5, 0.4)) -> Scene:
    return Scene.of(
        torch.from_numpy(np.array(mesh.vertices)),
        torch.from_numpy(np.array(mesh.faces)),
        torch.tensor(albedo),
    )


def ring_and_ball() -> Scene:
    """A torus round a ball: parts of both see little."""
    ring = trimesh.creation.torus(1.0, 0.3, major_sections=24, minor_sections=12)
    ring.apply_transform(trimesh.transformations.rotation_matrix(1.2, [1, 0, 0]))
    ball = trimesh.creation.icosphere(2, 0.5)
    ball.apply_translation([0.3, 0.6, 0.2])
    return Scene.joined([solid(ring), solid(ball)])


def transfer_of(scene: Scene, count: int, seed: int = 0) -> SurfaceTransfer:
    receivers = surface_points(scene, count, torch.Generator().manual_seed(seed))
    return surface_transfer(scene, receivers, GRID)


def lights(count: int, seed: int = 0) -> torch.Tensor:
    """White noise, never negative, float64."""
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, len(GRID), 3, generator=generator, dtype=torch.float64)
