"""Rays per second of the diffuse transport, against embree alone, and of rays by PyTorch."""

import time

import numpy as np
import pytest
import torch
import trimesh

from skylight.faces._model import HeadModel
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import SurfaceRays, diffuse_transport
from skylight.transport._rays import Raycaster, TorchRaycaster
from skylight.transport._render import vertex_normals
from skylight.transport._visibility import adaptive_visibility


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


@pytest.fixture(scope="module")
def head():
    """(vertices, faces, normals) of the mean head."""
    model = HeadModel.load()
    vertices, faces = torch.from_numpy(model.mean.copy()), torch.from_numpy(model.faces.copy())
    return vertices, faces, vertex_normals(vertices, faces)


@pytest.mark.benchmark(group="400,384 rays from a head")
@pytest.mark.parametrize("device", ["embree", "cpu", "cuda"])
def test_torch_rays(benchmark, head, device):
    """Those above the horizons of every 20th vertex, on 32 rows; how many differ from embree's."""
    vertices, faces, normals = head
    embree = Raycaster(vertices, faces)
    caster = torch_caster(vertices, faces, device) or embree
    starts = (vertices + embree.epsilon * normals)[::20].float()
    directions = DirectionGrid.latlong(32).directions.float()
    point, towards = (normals[::20].float() @ directions.T > 0).nonzero().unbind(1)
    rays = starts[point].contiguous(), directions[towards].contiguous()
    found = benchmark.pedantic(caster.occluded, rays, rounds=3, warmup_rounds=1)
    benchmark.extra_info |= {
        "rays": len(point),
        "differ_from_embree": int((found != embree.occluded(*rays)).sum()),
        "mrays_per_s": len(point) / benchmark.stats["min"] / 1e6,
    }
    print(benchmark.extra_info)


@pytest.mark.benchmark(group="visibility of 391 points of a head")
@pytest.mark.parametrize("device", ["embree", "cpu", "cuda"])
def test_torch_visibility(benchmark, head, device):
    vertices, faces, normals = head
    caster = torch_caster(vertices, faces, device) or Raycaster(vertices, faces)
    points = vertices[::20], normals[::20], normals[::20]
    benchmark.pedantic(adaptive_visibility, (*points, caster, 64), rounds=3, warmup_rounds=1)


def torch_caster(vertices, faces, device):
    """None for embree."""
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    if device == "embree":
        return None
    return TorchRaycaster(vertices, faces, torch.device(device))
