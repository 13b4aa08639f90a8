"""A printed part, and its mesh as a solid for boolean operations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Error, Manifold, Mesh64

from skylight.errors import InputError
from skylight.sphere.rigid_transform import RigidTransform


@dataclass(frozen=True, kw_only=True)
class PrintedPart:
    """A closed triangle mesh in mm; triangles are counter-clockwise seen from outside.

    ``up`` is the axis of the mesh's own frame that points away from the printer's bed.
    """

    name: str
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "f 3"]
    up: tuple[int, int, int] = (0, 0, 1)

    def __post_init__(self) -> None:
        if sorted(map(abs, self.up)) != [0, 0, 1]:
            raise InputError(f"part {self.name}: up must be one of the six axes, got {self.up}")
        if not len(self.faces) or self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise InputError(f"part {self.name}: its triangles must index its vertices")
        if not np.isfinite(self.vertices).all():
            raise InputError(f"part {self.name}: has vertices that are NaN or infinite")

    @property
    def corners(self) -> Float[np.ndarray, "f 3 3"]:
        """Corners of the triangles."""
        return self.vertices[self.faces]

    @property
    def volume_mm3(self) -> float:
        """``sum(a . (b x c)) / 6`` over the triangles (divergence theorem)."""
        a, b, c = self.corners.transpose(1, 0, 2)
        return float((a * np.cross(b, c)).sum() / 6)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """(low, high) corner of the axis-aligned box around it."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    def moved(self, motion: RigidTransform) -> "PrintedPart":
        """Elsewhere; the rotation takes axes to axes."""
        up = tuple(int(v) for v in np.rint(motion.directions(np.array(self.up, float))))
        return replace(self, vertices=motion.points(self.vertices), up=up)

    def shifted(self, translation: Float[np.ndarray, " 3"]) -> "PrintedPart":
        """At ``x + translation``."""
        return replace(self, vertices=self.vertices + translation)

    def solid(self) -> Manifold | None:
        """For boolean operations; None where the mesh does not enclose a volume."""
        solid = Manifold(Mesh64(vert_properties=self.vertices, tri_verts=self.faces))
        return solid if solid.status() == Error.NoError and not solid.is_empty() else None


def part_of(name: str, solid: Manifold, up: tuple[int, int, int] = (0, 0, 1)) -> PrintedPart:
    """The mesh of a solid."""
    mesh = solid.to_mesh64()
    vertices = np.array(mesh.vert_properties, np.float64)[:, :3]
    faces = np.array(mesh.tri_verts, np.int64)
    return PrintedPart(name=name, vertices=vertices, faces=faces, up=up)


def merged(
    parts: Sequence[PrintedPart],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"], Int[np.ndarray, " f"]]:
    """(vertices, faces, part of each face) of all parts in one mesh."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return (
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + at for part, at in zip(parts, first, strict=False)]),
        np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts]),
    )


def box(low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]) -> Manifold:
    """An axis-aligned box."""
    return Manifold.cube(tuple(high - low)).translate(tuple(low))
