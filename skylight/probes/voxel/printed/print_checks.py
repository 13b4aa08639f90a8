"""Checks of the printed parts of a voxel model."""

from collections.abc import Sequence

import numpy as np
from manifold3d import Manifold, OpType

from skylight.fabrication.checks import FlushContact, Joint, OuterShape, check_print
from skylight.fabrication.part import PrintedPart, box, part_of
from skylight.fabrication.report import PrintReport
from skylight.probes.voxel.faces import NORMALS, exposed_faces
from skylight.probes.voxel.printed.parts import VoxelParts
from skylight.probes.voxel.printed.press_fit import DOWN, FLUSH, opposite

_SAMPLES = 7  # along the side of a face
_MARGIN = 0.03  # of the side: seams beside flush parts are half a clearance wide


def check_voxel_parts(
    printed: VoxelParts, foot: PrintedPart, *, alone: Sequence[PrintedPart] = ()
) -> PrintReport:
    """Measure the parts of a voxel model, standing on their foot, and others ``alone``."""
    return check_print(
        [foot, *printed.parts],
        printed.sizes,
        joints=voxel_joints(printed),
        contacts=flush_contacts(printed),
        outer=outer_shape(printed),
        inside=range(1, len(printed.parts) + 1),
        ray_start_mm=printed.sizes.face_mm / 2,  # within the empty cell in front
        alone=alone,
    )


def voxel_joints(printed: VoxelParts) -> list[Joint]:
    """Joints of foot (place 0) and parts, in order of assembly."""
    assembly = printed.assembly
    return [
        Joint(
            carrier=int(assembly.parents[i]) + 1,
            plugged=i + 1,
            outward=_step(opposite(int(assembly.toward_parent[i]))),
        )
        for i in range(len(assembly))
    ]


def flush_contacts(printed: VoxelParts) -> list[FlushContact]:
    """Pairs of neighbours without a joint; parts count from 1."""
    assembly = printed.assembly
    place = {tuple(cell): i for i, cell in enumerate(assembly.cells.tolist())}
    return [
        FlushContact(
            first=i + 1,
            second=place[tuple((assembly.cells[i] + NORMALS[side]).tolist())] + 1,
            toward=_step(side),
        )
        for i in range(len(assembly))
        for side in (0, 2, 4)  # each pair once
        if assembly.sides[i, side] == FLUSH
    ]


def outer_shape(printed: VoxelParts) -> OuterShape:
    """The solid model and points on its exposed faces, but for that on the pole's foot."""
    size = printed.sizes.face_mm
    faces = exposed_faces(printed.model)
    hidden = (faces.orientation.numpy() == DOWN) & (
        faces.cells.numpy() == printed.assembly.cells[0]
    ).all(1)
    corners = size * faces.corners.numpy()[~hidden]
    along = np.linspace(_MARGIN, 1 - _MARGIN, _SAMPLES)
    u, v = (a.reshape(-1, 1) for a in np.meshgrid(along, along))
    right, forward = (corners[:, i, None] - corners[:, 0, None] for i in (1, 3))
    points = corners[:, 0, None] + u * right + v * forward
    normals = NORMALS[faces.orientation.numpy()[~hidden]].astype(float)
    cells = [box(size * cell.astype(float), size * (cell + 1.0)) for cell in printed.assembly.cells]
    solid = Manifold.batch_boolean(cells, OpType.Add)
    return OuterShape(
        model=part_of("model", solid),
        points=points.reshape(-1, 3),
        normals=np.repeat(normals, _SAMPLES**2, 0),
    )


def _step(side: int) -> tuple[int, int, int]:
    x, y, z = NORMALS[side].tolist()
    return x, y, z
