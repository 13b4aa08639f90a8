"""A voxel probe for the printer: parts, foot, marker base, and what was measured on them."""

from dataclasses import dataclass

import numpy as np

from skylight.cameras.pose import OPENCV_FROM_BOARD
from skylight.fabrication.layout import BedLayout, lay_out
from skylight.fabrication.mount import MarkerBoard, Mount, Pole, make_mount
from skylight.fabrication.report import PrintReport
from skylight.fabrication.sizes import PrintSizes
from skylight.probes.voxel.faces import OCCLUDERS, ORIENTATIONS, exposed_faces
from skylight.probes.voxel.model import VoxelModel
from skylight.probes.voxel.printed.assembly import VoxelAssembly
from skylight.probes.voxel.printed.parts import VoxelParts, voxel_parts
from skylight.probes.voxel.printed.press_fit import DOWN
from skylight.probes.voxel.printed.print_checks import check_voxel_parts
from skylight.sphere.rigid_transform import RigidTransform
from skylight.work.progress import StageProgress


@dataclass(frozen=True, kw_only=True)
class PrintedProbe:
    """All that was made of a model: parts and mount as assembled, on the bed, and as measured."""

    title: str
    printed: VoxelParts
    pole: Pole
    board: MarkerBoard
    mount: Mount
    bed: BedLayout
    report: PrintReport

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
        title=title, printed=printed, pole=pole, board=board, mount=mount, bed=bed, report=report
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
