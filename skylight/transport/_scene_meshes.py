"""The meshes of the evaluation scene: a ground with things on it, and two of metal.

Beside :mod:`skylight.transport._scene`, which seldom needs them: trimesh is slow to import.
"""

import numpy as np
import torch
import trimesh.creation as make
from jaxtyping import Bool, Float, Int
from torch import Tensor
from trimesh.transformations import rotation_matrix

GROUND_Y = -1.5  # the camera is at the origin, so it stands 1.5 above the ground


def diffuse_mesh() -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"], Bool[Tensor, " f"]]:
    """A ball, a ring, a block and a rabbit on the ground, and which faces are the ground's."""
    return _mesh(_diffuse_parts())


def metal_mesh() -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """A ball and a ring."""
    vertices, faces, _ = _mesh(_metal_parts())
    return vertices, faces


def _diffuse_parts() -> list:
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
    ring = make.torus(0.42, 0.17, major_sections=128, minor_sections=48)
    ring.apply_transform(_turned(-0.5, axis=(1.0, 1.0, 0.0)))
    ball = make.icosphere(subdivisions=5, radius=0.62)
    return [_at(ball, (-0.72, -0.95, -3.2)), _at(ring, (0.8, -0.95, -3.2))]


def _rabbit() -> list:
    """Body, head, ears, paws and tail of a sitting rabbit that looks to the left; feet at y = 0."""

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
    return np.asarray(rotation_matrix(angle_rad, axis))


def _at(part, position: tuple):
    part.apply_translation(position)
    return part


def _faceted(part):
    part.unmerge_vertices()
    return part


def _mesh(
    parts: list,
) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"], Bool[Tensor, " f"]]:
    """All parts as one mesh, and which faces are the first part's."""
    first = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([np.asarray(part.vertices) for part in parts])
    faces = np.concatenate(
        [np.asarray(part.faces) + start for part, start in zip(parts, first[:-1], strict=True)]
    )
    in_first = torch.arange(len(faces)) < len(parts[0].faces)
    return torch.from_numpy(vertices), torch.from_numpy(faces), in_first
