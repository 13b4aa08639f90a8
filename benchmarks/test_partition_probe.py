"""Partition probes at run time: a scene of 100,000 vertices made ready, and relit every frame."""

import pytest
import torch
import trimesh

from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.relight._atlas import refined
from skylight.probes.partitions.relight._composite import Relighting, TurningRelighting
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import (
    TransferCoefficients,
    transfer_coefficients,
)

VERTICES = 100_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Three balls on a ground."""
    albedo = torch.tensor([0.7, 0.6, 0.5]).double()
    ball = trimesh.creation.icosphere(subdivisions=5)
    parts = []
    for x in (-2.2, 0.0, 2.2):
        places = torch.from_numpy(ball.vertices.copy()) + torch.tensor([x, 1.0, 0.0]).double()
        parts.append(Scene.of(places, torch.from_numpy(ball.faces.copy()), albedo))
    corners = torch.tensor([[-1.0, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]).double() * 6
    ground = Scene.of(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]), albedo)
    return Scene.joined([*parts, refined(ground, 0.05)])


def test_transfer_of_many_vertices(benchmark, scene: Scene) -> None:
    """14 cells, 512 rays, 3 bounces, on two processes."""
    assert len(scene.vertices) > VERTICES
    cells = Cells.of(named_design("14d"))
    found = benchmark.pedantic(
        transfer_coefficients, (scene, cells), {"workers": 2}, rounds=1, iterations=1
    )
    assert len(found) == len(scene.vertices)
    benchmark.extra_info["vertices"] = len(scene.vertices)


def test_relight_many_vertices(benchmark) -> None:
    """One light of 14 cells onto 100,000 vertices."""
    values = torch.rand(VERTICES, 14, 3, generator=torch.Generator().manual_seed(0))
    relighting = Relighting(TransferCoefficients(values=values, orders=torch.ones(1)))
    light = torch.rand(1, 14, 3, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found = benchmark(relighting, light)
    assert found.shape == (1, VERTICES, 3)


def test_relight_many_vertices_turned(benchmark) -> None:
    """The same at any angle, by a spline through 24: four times the coefficients are read."""
    values = torch.rand(24, VERTICES, 14, 3, generator=torch.Generator().manual_seed(0))
    relighting = TurningRelighting(TransferCoefficients(values=values, orders=torch.ones(1)))
    del values
    light = torch.rand(1, 14, 3, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found = benchmark(relighting, light, 1.0)
    assert found.shape == (1, VERTICES, 3)
    benchmark.extra_info["coefficients_mb"] = relighting.spline.nbytes / 1e6
