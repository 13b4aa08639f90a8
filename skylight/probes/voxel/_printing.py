"""A voxel probe for the printer: parts, foot, marker base, and what was measured on them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, OpType

from skylight.probes._printing import MountedPrint
from skylight.probes.cameras._pose import OPENCV_FROM_BOARD
from skylight.probes.fabrication._checks import FlushContact, Joint, OuterShape, check_print
from skylight.probes.fabrication._mount import MarkerBoard, Mount, Pole, make_mount
from skylight.probes.fabrication._parts import (
    PrintedPart,
    PrintSizes,
    box,
    lay_out,
    part_of,
)
from skylight.probes.fabrication._report import PrintReport
from skylight.probes.voxel._assembly import VoxelAssembly
from skylight.probes.voxel._model import NORMALS, OCCLUDERS, ORIENTATIONS, VoxelModel, exposed_faces
from skylight.probes.voxel._parts import VoxelParts, voxel_parts
from skylight.probes.voxel._press_fit import DOWN, FLUSH, opposite
from skylight.sphere._rotation import RigidTransform
from skylight.work._progress import StageProgress

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


@dataclass(frozen=True, kw_only=True)
class PrintedProbe(MountedPrint):
    """All that was made of a model: parts and mount as assembled, on the bed, and as measured."""

    title: str
    printed: VoxelParts
    mount: Mount
    report: PrintReport

    @property
    def paper_hole_mm(self) -> float:
        return self.mount.paper_hole_mm

    @property
    def saved(self) -> float:
        """The share of the solid model's material that the parts do not need."""
        return 1 - self.printed.volume_mm3 / self.printed.solid_mm3


def print_voxel_probe(
    model: VoxelModel,
    sizes: PrintSizes,
    *,
    title: str,
    pole: Pole | None = None,
    board: MarkerBoard | None = None,
    spacing_mm: float = 3.0,
    progress: StageProgress | None = None,
) -> PrintedProbe:
    """Parts of a voxel model, its foot and base, laid out and measured.

    Raises
    ------
    InputError
        The model cannot be put together, or the sizes do not fit one another.
    """
    tell = progress or (lambda _stage, _share: None)
    pole, board = pole or Pole(), board or MarkerBoard()
    tell("making the parts", 0.0)
    printed = voxel_parts(model, sizes)
    mount = make_mount(printed.mount_lattice, printed.mount_collar, sizes, pole, board)
    bed = lay_out([*printed.parts, mount.foot], spacing_mm=spacing_mm)
    tell("measuring the parts", 0.3)
    report = check_voxel_parts(printed, mount.foot, alone=[mount.base])
    return PrintedProbe(
        title=title,
        printed=printed,
        pole=pole,
        board=board,
        mount=mount,
        base=mount.base,
        bed=bed,
        report=report,
    )


def voxel_assembly(result: PrintedProbe) -> VoxelAssembly:
    """The probe on its pole in the frame of the board, as captures expect it."""
    mount, pole = result.mount, result.pole
    board_from_opencv = RigidTransform.from_numpy(OPENCV_FROM_BOARD.T, np.zeros(3))
    board_from_probe = board_from_opencv @ mount.board_from_probe
    face_mm = result.printed.sizes.face_mm
    cell = result.printed.assembly.cells[0].astype(np.float64)
    x, top, z = board_from_probe.points(face_mm * (cell + np.array([0.5, 0.0, 0.5])))
    return VoxelAssembly(
        model=result.printed.model,
        voxel_mm=face_mm,
        board_from_probe=board_from_probe,
        pole_mm=(float(x), float(z), pole.diameter_mm / 2, float(top)),
        board_mm=(result.board.width_mm, result.board.height_mm),
    )


def hidden_by_pole(result: PrintedProbe) -> dict[str, object]:
    """The face that the foot covers, and whether its lightmap slot has no other face."""
    faces = exposed_faces(result.printed.model)
    orientation, configuration = faces.orientation.numpy(), faces.configuration.numpy()
    cell = result.printed.assembly.cells[0]
    at = int(np.flatnonzero((orientation == DOWN) & (faces.cells.numpy() == cell).all(1))[0])
    slot = int(configuration[at])
    alike = int(((orientation == DOWN) & (configuration == slot)).sum()) - 1
    return {
        "voxel": cell.tolist(),
        "face": at,
        "orientation": ORIENTATIONS[DOWN],
        "configuration": slot,
        "occluders": [name for i, name in enumerate(OCCLUDERS) if slot >> i & 1],
        "other_faces_of_this_slot": alike,
        "slot_lost": alike == 0,
    }
