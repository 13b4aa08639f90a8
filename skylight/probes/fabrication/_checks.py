"""Printability checks on meshes: walls, overhangs, clearances, collisions.

The checks use the meshes alone, not the construction, so they find its errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from manifold3d import Manifold

from skylight.probes.fabrication._parts import PrintedPart, PrintSizes, box, merged
from skylight.probes.fabrication._report import (
    ContactFigures,
    JointFigures,
    PartFigures,
    PrintReport,
)
from skylight.probes.fabrication._watertight import broken_edges
from skylight.transport._rays import Raycaster

_SAMPLE_PITCH_MM = 0.8
_MOST_SAMPLES = 400  # of a triangle
_START_MM = 1e-3  # below the surface, where rays start
_OVERLAP_MM3 = 1e-7
_FAR = 4.0  # clearances up to which play is looked for
_BISECTIONS = 10  # to a two-hundredth of a clearance
_OVERHANG_COS = np.cos(np.pi / 4) + 1e-6  # steeper than 45 degrees prints without support


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Part ``plugged`` slides against ``outward`` onto ``carrier``; both are places in a list."""

    carrier: int
    plugged: int
    outward: tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class FlushContact:
    """Parts ``first`` and, in direction ``toward`` from it, ``second`` that only lie close."""

    first: int
    second: int
    toward: tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class OuterShape:
    """What the assembled parts should look like: the solid model, and points on its faces."""

    model: PrintedPart
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]


def check_print(
    parts: Sequence[PrintedPart],
    sizes: PrintSizes,
    *,
    joints: Sequence[Joint],
    contacts: Sequence[FlushContact] = (),
    outer: OuterShape,
    inside: Sequence[int],
    ray_start_mm: float,
    alone: Sequence[PrintedPart] = (),
) -> PrintReport:
    """Check parts in their assembled poses, in order of assembly.

    ``inside`` names the parts that belong to the outer shape (a foot does not). Rays onto the
    outer faces start ``ray_start_mm`` in front of them. Parts ``alone`` are measured by themselves.
    """
    solids = [part.solid() for part in parts]
    shell = [parts[i] for i in inside]
    return PrintReport(
        sizes=sizes,
        parts=tuple(part_figures(part) for part in (*parts, *alone)),
        joints=tuple(_joint_figures(parts, solids, joint, sizes) for joint in joints),
        contacts=tuple(_contact_figures(parts, solids, c, sizes) for c in contacts),
        overlap_mm3=overlap_mm3(solids),
        blocked=_blocked(parts, solids, joints, sizes),
        face_deviation_mm=face_deviation_mm(shell, outer, ray_start_mm),
        outside_mm3=_outside_mm3([solids[i] for i in inside], outer),
    )


def part_figures(part: PrintedPart, *, opposed_cos: float = 0.0) -> PartFigures:
    """Whether a part is one closed, rightly turned surface, its thinnest wall and overhang.

    Closed as a file's readers find it, in float32 and with vertices told apart by their place.
    """
    from trimesh import Trimesh  # slow to import

    mesh = Trimesh(part.vertices, part.faces, process=False)
    area, bridge = overhang(part)
    return PartFigures(
        name=part.name,
        watertight=not len(broken_edges(part.corners)),
        consistent=bool(mesh.is_winding_consistent),
        pieces=int(mesh.body_count),
        volume_mm3=part.volume_mm3,
        thinnest_mm=thinnest_wall_mm(part, opposed_cos=opposed_cos),
        overhang_mm2=area,
        bridge_mm=bridge,
    )


def thinnest_wall_mm(part: PrintedPart, *, opposed_cos: float = 0.0) -> float:
    """The shortest way through material, straight inward from samples all over the surface.

    Samples are at most 0.8 mm apart, and near every corner of every triangle. A surface from
    which the ray never comes out (a hole, or turned inside out) has thickness 0.

    With ``opposed_cos``, only surfaces count that face away from each other by that cosine or
    more: where two sides run together in an edge, however sharp, they make no wall.
    """
    points, normals = surface_samples(part)
    caster = _caster([part])
    inward = torch.from_numpy(-normals)
    hits = caster.intersect(torch.from_numpy(points - _START_MM * normals), inward)
    faces = part.corners[hits.face.clamp(min=0).numpy()]
    exit_normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    opposed = (exit_normal * -normals).sum(1)
    opposed /= np.maximum(np.linalg.norm(exit_normal, axis=1), 1e-300)
    leaves = (opposed > opposed_cos) & (hits.face >= 0).numpy()
    thickness = np.where(leaves, hits.distance.numpy(), -_START_MM)
    if opposed_cos > 0 and leaves.any():
        thickness = thickness[leaves]
    return float(thickness.min() + _START_MM)


def surface_samples(
    part: PrintedPart,
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]]:
    """(points, unit normals) spread over the triangles, in proportion to their area."""
    corners = part.corners
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(cross, axis=1)
    real = double > 1e-9  # slivers of booleans have no normal
    corners, cross, double = corners[real], cross[real], double[real]
    count = np.clip(np.ceil(double / 2 / _SAMPLE_PITCH_MM**2), 1, _MOST_SAMPLES).astype(int)
    face = np.repeat(np.arange(len(corners)), count)
    number = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    # the plastic number's sequence (Roberts 2018), folded into the triangle
    u = np.stack([0.3 + number * 0.7548776662466927, 0.3 + number * 0.5698402909980532], 1) % 1
    u = np.where((u.sum(1) > 1)[:, None], 1 - u, u)
    spread = np.concatenate([1 - u.sum(1, keepdims=True), u], 1)
    near = np.full((3, 3), 0.005) + 0.985 * np.eye(3)
    weights = np.concatenate([spread, np.tile(near, (len(corners), 1))])
    face = np.concatenate([face, np.repeat(np.arange(len(corners)), 3)])
    points = (weights[:, :, None] * corners[face]).sum(1)
    return points, cross[face] / double[face, None]


def overhang(part: PrintedPart) -> tuple[float, float]:
    """(mm2, mm) of what faces down flatter than 45 degrees above the bed, and its longest side."""
    corners, up = part.corners, np.array(part.up, float)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1) / 2
    down = -(cross @ up) / np.maximum(2 * area, 1e-300)
    height = part.vertices @ up
    flat = (down > _OVERHANG_COS) & ((corners @ up).max(1) > height.min() + 1e-6)
    if not flat.any():
        return 0.0, 0.0
    from trimesh.graph import connected_components  # slow to import

    faces = part.faces[flat]
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    regions = connected_components(edges, nodes=np.unique(faces), min_len=1)
    longest = max(float(np.ptp(part.vertices[region], axis=0).max()) for region in regions)
    return float(area[flat].sum()), longest


def overlap_mm3(solids: Sequence[Manifold | None]) -> float:
    """Volume that parts share, summed over pairs; infinite where a part is no solid."""
    if any(solid is None for solid in solids):
        return float("inf")
    boxes = np.array([s.bounding_box() for s in solids if s is not None]).reshape(-1, 2, 3)
    total = 0.0
    for i, solid in enumerate(solids):
        close = ((boxes[i, 0] < boxes[:, 1]) & (boxes[:, 0] < boxes[i, 1])).all(1)
        total += sum(_shared(solid, solids[j]) for j in np.flatnonzero(close).tolist() if j > i)
    return total


def play_mm(
    fixed: Manifold | None, moving: Manifold | None, direction: np.ndarray, farthest_mm: float
) -> float:
    """How far a solid moves before it meets another: 0 where they overlap already.

    By bisection on the shared volume; ``farthest_mm`` where it does not meet the other before.
    """
    if fixed is None or moving is None or _shared(fixed, moving) > _OVERLAP_MM3:
        return 0.0
    fixed, moving = _near(fixed, moving, farthest_mm), _near(moving, fixed, farthest_mm)

    def meets(distance: float) -> bool:
        moved = moving.translate(tuple(distance * direction.astype(float)))
        return _shared(fixed, moved) > _OVERLAP_MM3

    if not meets(farthest_mm):
        return farthest_mm
    free, stopped = 0.0, farthest_mm
    for _ in range(_BISECTIONS):
        middle = (free + stopped) / 2
        free, stopped = (free, middle) if meets(middle) else (middle, stopped)
    return (free + stopped) / 2


def face_deviation_mm(
    parts: Sequence[PrintedPart], outer: OuterShape, ray_start_mm: float
) -> float:
    """The farthest that the parts' surface is from points on the model's, along the normal."""
    origins = torch.from_numpy(outer.points + ray_start_mm * outer.normals)
    hits = _caster(parts).intersect(origins, torch.from_numpy(-outer.normals))
    return float((hits.distance - ray_start_mm).abs().max())


def _joint_figures(
    parts: Sequence[PrintedPart],
    solids: Sequence[Manifold | None],
    joint: Joint,
    sizes: PrintSizes,
) -> JointFigures:
    fixed, moving = solids[joint.carrier], solids[joint.plugged]
    farthest = _FAR * sizes.clearance_mm
    outward = np.array(joint.outward)
    sideways = [s * axis for axis in np.eye(3, dtype=int) if not axis @ outward for s in (1, -1)]
    return JointFigures(
        carrier=parts[joint.carrier].name,
        plugged=parts[joint.plugged].name,
        clearances_mm=tuple(play_mm(fixed, moving, side, farthest) for side in sideways),
        stop_mm=play_mm(fixed, moving, -outward, farthest),
    )


def _contact_figures(
    parts: Sequence[PrintedPart],
    solids: Sequence[Manifold | None],
    contact: FlushContact,
    sizes: PrintSizes,
) -> ContactFigures:
    gap = play_mm(
        solids[contact.first],
        solids[contact.second],
        -np.array(contact.toward),
        _FAR * sizes.clearance_mm,
    )
    return ContactFigures(
        first=parts[contact.first].name, second=parts[contact.second].name, gap_mm=gap
    )


def _blocked(
    parts: Sequence[PrintedPart],
    solids: Sequence[Manifold | None],
    joints: Sequence[Joint],
    sizes: PrintSizes,
) -> tuple[str, ...]:
    """Parts that meet an earlier one on their way in, tried at every half wall."""
    step = sizes.wall_mm / 2
    blocked = []
    for joint in joints:
        moving, outward = solids[joint.plugged], np.array(joint.outward, float)
        if meets_on_its_way(solids[: joint.plugged], moving, outward, step):
            blocked.append(parts[joint.plugged].name)
    return tuple(blocked)


def meets_on_its_way(
    fixed: Sequence[Manifold | None],
    moving: Manifold | None,
    outward: Float[np.ndarray, " 3"],
    step_mm: float,
) -> bool:
    """Whether a solid that comes in from ``outward`` meets another, tried at every step."""
    there = [s for s in fixed if s is not None]
    if moving is None or not there:
        return False
    boxes = np.array([s.bounding_box() for s in there]).reshape(-1, 2, 3)
    own = np.array(moving.bounding_box()).reshape(2, 3)
    away = float(np.abs(outward) @ (np.ptp(own, axis=0) + np.ptp(boxes, axis=(0, 1))))
    for distance in np.arange(step_mm, away + step_mm, step_mm).tolist():
        low, high = own + distance * outward
        close = ((low < boxes[:, 1] - 1e-6) & (boxes[:, 0] + 1e-6 < high)).all(1)
        if not close.any():
            continue
        moved = moving.translate(tuple(distance * outward))
        if any(_shared(there[i], moved) > _OVERLAP_MM3 for i in np.flatnonzero(close)):
            return True
    return False


def _outside_mm3(solids: Sequence[Manifold | None], outer: OuterShape) -> float:
    """Volume of the parts that sticks out of the model."""
    model = outer.model.solid()
    if model is None or any(solid is None for solid in solids):
        return float("inf")
    return sum(max(0.0, (solid - model).volume()) for solid in solids if solid is not None)


def _shared(first: Manifold | None, second: Manifold | None) -> float:
    if first is None or second is None:
        return float("inf")
    return max(0.0, (first ^ second).volume())


def _near(solid: Manifold, other: Manifold, reach_mm: float) -> Manifold:
    """What of a solid another can meet within ``reach_mm``; booleans cost by the triangle."""
    low, high = np.array(other.bounding_box()).reshape(2, 3)
    return solid ^ box(low - 2 * reach_mm, high + 2 * reach_mm)


def _caster(parts: Sequence[PrintedPart]) -> Raycaster:
    vertices, faces, _ = merged(parts)
    return Raycaster(torch.from_numpy(vertices), torch.from_numpy(faces))
