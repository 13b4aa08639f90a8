"""Rays per second of the diffuse transport, against embree alone on the same rays."""

import time

import numpy as np
import pytest
import torch
import trimesh

from skylight.sphere.grid import DirectionGrid
from skylight.transport.gbuffer import vertex_normals
from skylight.transport.matrix import SurfaceRays, diffuse_transport
from skylight.transport.raycast import Raycaster


@pytest.fixture(scope="module")
def surface():
    mesh = trimesh.creation.icosphere(subdivisions=5)  # 10242 vertices
    vertices = torch.from_numpy(np.array(mesh.vertices))
    vertices = vertices * (1 + 0.1 * torch.sin(7 * vertices).prod(1, keepdim=True))  # some hollows
    faces = torch.from_numpy(np.array(mesh.faces))
    return vertices, vertex_normals(vertices, faces), Raycaster(vertices, faces)


def embree_alone(vertices, normals, caster, grid):
    """(rays, seconds) of embree on the transport's rays, all arrays made beforehand."""
    surface = SurfaceRays.leaving(vertices, normals, normals, caster)
    cosines = surface.normals @ grid.directions.numpy().astype(np.float32).T
    rays, seconds = 0, 0.0
    for direction, cosine in zip(grid.directions.float(), cosines.T, strict=True):
        # numpy, not torch: idle torch threads would spin on the cores being timed
        starts = torch.from_numpy(surface.starts[cosine > 0])
        directions = torch.from_numpy(np.tile(direction.numpy(), (len(starts), 1)))
        begin = time.perf_counter()
        caster.occluded(starts, directions)
        seconds += time.perf_counter() - begin
        rays += len(starts)
    return rays, seconds


def test_diffuse_transport(benchmark, surface):
    vertices, normals, caster = surface
    grid = DirectionGrid.latlong(32)
    benchmark.pedantic(
        diffuse_transport, (vertices, normals, normals, caster, grid), rounds=3, warmup_rounds=1
    )
    rays, seconds = min(embree_alone(vertices, normals, caster, grid) for _ in range(3))
    benchmark.extra_info |= {
        "rays": rays,
        "transport_mrays_per_s": rays / benchmark.stats["min"] / 1e6,
        "embree_mrays_per_s": rays / seconds / 1e6,
        "ratio": seconds / benchmark.stats["min"],
    }
    print(benchmark.extra_info)
