"""Scenes to light, and a probe of six cells."""

import numpy as np
import torch
import trimesh

from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions.relight._atlas import refined
from skylight.probes.partitions.relight._scene import Scene

QUAD = torch.tensor([[0, 1, 2], [0, 2, 3]])
AXES = torch.cat([torch.eye(3), -torch.eye(3)]).double()
SKEW = torch.tensor(
    [
        [1, 0.2, 0.1],
        [-0.3, 1, 0.2],
        [0.1, -0.2, 1],
        [-1, 0.3, 0.3],
        [0.2, -1, 0.4],
        [0.3, 0.1, -1.0],
    ]
)


def six_cells(seeds: torch.Tensor = SKEW) -> Cells:
    return Cells.of(ProbeDesign.of("six", seeds.double()))


def quad(*corners, albedo=(0.5, 0.5, 0.5)) -> Scene:
    return Scene.of(torch.tensor(corners, dtype=torch.float64), QUAD, torch.tensor(albedo))


def corner(floor, wall, longest_edge: float) -> Scene:
    """The floor [0, 1]^2 in x and z, and a wall above its edge x = 0."""
    return refined(
        Scene.joined(
            [
                quad([0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0], albedo=floor),
                quad([0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], albedo=wall),
            ]
        ),
        longest_edge,
    )


def solid(mesh: trimesh.Trimesh, albedo=(0.6, 0.5, 0.4)) -> Scene:
    return Scene.of(
        torch.from_numpy(np.array(mesh.vertices)),
        torch.from_numpy(np.array(mesh.faces)),
        torch.tensor(albedo),
    )
