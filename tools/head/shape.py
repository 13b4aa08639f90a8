"""The shape model: mean and bases on the cage, carried to the refined mesh."""

from dataclasses import dataclass

import numpy as np

from tools.head.assets import ADULT_SCALE, DECIMETRE, Assets
from tools.head.bases import align, expression_basis, identity_basis
from tools.head.cage import cut_head, neutral
from tools.head.people import sample_heads
from tools.head.topology import subdivide, triangulate


@dataclass(frozen=True)
class Shape:
    """Mean and bases on the final mesh, metres, origin mid-head."""

    mean: np.ndarray
    identity: np.ndarray
    expression: np.ndarray
    expression_names: list[str]
    faces: np.ndarray
    part: np.ndarray
    ear: np.ndarray


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A third of the area of each vertex's triangles (n,), square metres."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    third = np.linalg.norm(normal, axis=1) / 6
    return np.bincount(faces.ravel(), np.repeat(third, 3), len(vertices))


def build_shape(assets: Assets, components: int, samples: int, seed: int) -> Shape:
    """Sample heads, reduce them to a basis, refine the mesh on the face."""
    cage = cut_head(assets)
    reference = neutral(assets)[cage.keep] * (DECIMETRE * ADULT_SCALE)
    faces = triangulate(cage.quads, reference)
    area = vertex_areas(reference, faces)
    skin = cage.part == 0
    above_chin = reference[:, 1] > 0.74
    front = reference[:, 2] > 0.06

    heads = sample_heads(assets, cage, np.random.default_rng(seed), samples)
    heads = align(heads, reference, area * (skin & above_chin)).astype(np.float32)
    # The neck and the inside of the head would spend components on what no photo shows.
    weight = area * np.where(above_chin, np.where(front, 1.0, 0.3), 0.1)
    mean, identity, share = identity_basis(heads, cage, weight, components)
    print(f"{components} components hold {share:.2%} of the weighted variance of {samples} heads")
    expression, names = expression_basis(assets, cage)

    ear = np.zeros(len(cage.keep))
    for side in "lr":
        # What these two move is the ear itself; the scale and shape sliders drag skin along.
        for target in ("wing-incr", "lobe-incr"):
            offset = assets.offsets(f"targets/ears/{side}-ear-{target}")[cage.keep]
            size = np.linalg.norm(offset, axis=1)
            ear = np.maximum(ear, size / size.max())

    eyes = mean[(cage.part == 1) | (cage.part == 2)].mean(axis=0)
    ears = mean[ear > 0.03].mean(axis=0)
    mean = mean - [0.0, eyes[1], 0.5 * (eyes[2] + ears[2])]

    # Refine where light is read off the face, and the coarse eyeballs: 5 mm edges at most.
    _, y, z = mean.T
    wanted = (skin & (z > 0.0) & (y > -0.14) & (ear < 0.03)) | (cage.part == 1) | (cage.part == 2)
    faces = triangulate(cage.quads, mean)
    faces, matrix = subdivide(faces, mean, wanted, longest=0.005)

    def carry(values: np.ndarray) -> np.ndarray:
        return (matrix @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])

    # A split edge never joins two parts, so any of its ends tells the part.
    part = cage.part[np.asarray(matrix.argmax(axis=1)).ravel()]
    return Shape(carry(mean), carry(identity), carry(expression), names, faces, part, carry(ear))
