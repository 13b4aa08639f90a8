"""Printed parts: a mesh as a solid for boolean operations, its dimensions, and a printer's bed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from skylight.errors import InputError
from skylight.probes.fabrication._watertight import watertight_mesh
from skylight.sphere._rotation import RigidTransform

if TYPE_CHECKING:
    from manifold3d import Manifold

_WIDTHS = 60  # shelf widths that are tried


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

    def solid(self) -> "Manifold | None":
        """For boolean operations; None where the mesh does not enclose a volume."""
        from manifold3d import Error, Manifold, Mesh64

        solid = Manifold(Mesh64(vert_properties=self.vertices, tri_verts=self.faces))
        return solid if solid.status() == Error.NoError and not solid.is_empty() else None


def part_of(name: str, solid: "Manifold", up: tuple[int, int, int] = (0, 0, 1)) -> PrintedPart:
    """The mesh of a solid, as a file can hold it."""
    vertices, faces = watertight_mesh(solid)
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


def box(low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]) -> "Manifold":
    """An axis-aligned box."""
    from manifold3d import Manifold

    return Manifold.cube(tuple(high - low)).translate(tuple(low))


@dataclass(frozen=True, kw_only=True)
class PrintSizes:
    """Side of a voxel face, thickness of all walls, and gap per side of what slides together; mm.

    A collar of one part plugs ``collar_mm`` deep into the open side of the next.
    """

    face_mm: float = 20.0
    wall_mm: float = 1.6
    clearance_mm: float = 0.15

    def __post_init__(self) -> None:
        for name in ("face_mm", "wall_mm", "clearance_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be a length above 0 mm, got {value:g}")
        if self.clearance_mm >= self.wall_mm:
            raise InputError(
                f"clearance_mm {self.clearance_mm:g} must be below wall_mm {self.wall_mm:g}, or "
                "the parts fall through one another; 0.1 to 0.3 suits most printers"
            )
        least = 6 * self.wall_mm + 4 * self.clearance_mm
        if self.face_mm < least - 1e-9:
            enough = math.ceil(10 * least - 1e-6) / 10
            raise InputError(
                f"walls of {self.wall_mm:g} mm leave no room for a joint in a face of "
                f"{self.face_mm:g} mm: make the face {enough:g} mm or more (6 walls and "
                "4 clearances), or the walls thinner"
            )

    @property
    def collar_mm(self) -> float:
        """How deep collars go: a quarter of the face."""
        return self.face_mm / 4

    @property
    def frame_mm(self) -> float:
        """Width of the frame that is left of a side which the next part covers.

        A wall, the gap, the collar's wall, and one clearance for what neighbours may be inset.
        """
        return 2 * self.wall_mm + 2 * self.clearance_mm


@dataclass(frozen=True, kw_only=True)
class BedLayout:
    """Parts as they lie on the bed (z = 0, first corner at the origin), in the order given."""

    parts: tuple[PrintedPart, ...]
    size_mm: tuple[float, float, float]

    @property
    def volume_mm3(self) -> float:
        """Of the box around all parts."""
        return float(np.prod(self.size_mm))


def lay_out(parts: Sequence[PrintedPart], *, spacing_mm: float = 3.0) -> BedLayout:
    """Each part upright (its ``up`` to +Z), on shelves of the width with the smallest volume.

    Parts go onto shelves by decreasing depth, the next shelf begins where one is full ("next fit
    decreasing height", Coffman et al. 1980); a number of widths is tried.
    """
    if not parts:
        raise InputError("there is no part to lay out")
    if not spacing_mm >= 0:
        raise InputError(f"spacing_mm must be 0 or more, got {spacing_mm}")
    upright = [_upright(part) for part in parts]
    sizes = np.array([np.ptp(part.bounds, axis=0) for part in upright]) + spacing_mm
    order = sorted(range(len(parts)), key=lambda i: (-sizes[i, 1], -sizes[i, 0], i))
    narrowest, row = sizes[:, 0].max(), sizes[:, 0].sum()
    best: tuple[float, float, np.ndarray] | None = None
    for width in np.linspace(narrowest, row, _WIDTHS):
        places = _shelves(sizes[order], float(width))
        across, deep = (places + sizes[order, :2]).max(0)
        # of equal areas the squarest
        area = float(across * deep), float(max(across, deep))
        if best is None or area < best[:2]:
            best = (*area, places)
    assert best is not None
    corner = np.zeros((len(parts), 3))
    corner[order, :2] = best[2]
    placed = [part.shifted(at - part.bounds[0]) for part, at in zip(upright, corner, strict=True)]
    width, depth, height = np.max([part.bounds[1] for part in placed], axis=0).tolist()
    return BedLayout(parts=tuple(placed), size_mm=(width, depth, height))


def _upright(part: PrintedPart) -> PrintedPart:
    """With ``up`` along +Z and the longer side of its footprint along X."""
    up = np.array(part.up)
    across = np.roll(np.abs(up), 1)
    turn = np.stack([across, np.cross(up, across), up]).astype(float)
    turned = part.moved(RigidTransform.from_numpy(turn, np.zeros(3)))
    width, depth, _ = np.ptp(turned.bounds, axis=0)
    if depth > width + 1e-9:
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        turned = turned.moved(RigidTransform.from_numpy(quarter, np.zeros(3)))
    return turned


def _shelves(sizes: Float[np.ndarray, "n 3"], width: float) -> Float[np.ndarray, "n 2"]:
    """First corners of boxes that come by decreasing depth."""
    places = np.zeros((len(sizes), 2))
    x = y = depth = 0.0
    for i, (across, deep, _) in enumerate(sizes):
        if x and x + across > width + 1e-9:
            x, y, depth = 0.0, y + depth, 0.0
        places[i] = x, y
        x, depth = x + across, max(depth, deep)
    return places
