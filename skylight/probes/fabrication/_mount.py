"""The mount of a probe: a foot for its pole, and a base with a recess for a ChArUco board.

Board frame, as OpenCV has it since 4.6: the origin is the top left corner of the printed pattern,
x points right and y down in the picture, z into the board, away from who looks at it; mm. The base
lies on a table and the probe stands above: +X of the probe is the board's x, +Z its y (towards
the reader), and +Y, up, its -z.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold

from skylight.errors import InputError
from skylight.probes.fabrication._parts import PrintedPart, PrintSizes, box, part_of
from skylight.sphere._rotation import RigidTransform

BOARD_FROM_PROBE = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_SEGMENTS = 96
_NOTCH_MM = 0.8


@dataclass(frozen=True, kw_only=True)
class Pole:
    """A round rod that goes into the foot above and the base below, up to their stops; mm."""

    diameter_mm: float = 6.0
    length_mm: float = 120.0

    def __post_init__(self) -> None:
        for name in ("diameter_mm", "length_mm"):
            _check_length(f"pole {name}", getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class MarkerBoard:
    """The printed pattern's size without margin, the paper's margin around it and thickness; mm."""

    width_mm: float = 175.0
    height_mm: float = 125.0
    margin_mm: float = 5.0
    paper_mm: float = 0.2

    def __post_init__(self) -> None:
        for name in ("width_mm", "height_mm", "margin_mm", "paper_mm"):
            _check_length(f"board {name}", getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Foot (in the probe's frame), base (in the board's), and the transform between the frames, mm.

    Both parts clear the pole by the sizes' clearance. The rotation about the pole's axis is free:
    notches in the middle of the foot's and the base's front edges show it.
    """

    foot: PrintedPart
    base: PrintedPart
    board_from_probe: RigidTransform
    paper_hole_mm: float

    def on_base(self, part: PrintedPart) -> PrintedPart:
        """A part of the probe's frame, in the board's."""
        return part.moved(self.board_from_probe)


def make_mount(
    face: Float[np.ndarray, "3 2"],
    collar: Float[np.ndarray, "3 2"],
    sizes: PrintSizes,
    pole: Pole,
    board: MarkerBoard,
) -> Mount:
    """The mount of a probe whose lowest cell has bounds ``face`` and takes this ``collar``."""
    radius = pole.diameter_mm / 2 + sizes.clearance_mm
    room = float(np.diff(collar[[0, 2]], axis=1).min()) / 2
    if radius + sizes.wall_mm > room:
        raise InputError(
            f"a pole of {pole.diameter_mm:g} mm does not fit into a face of {sizes.face_mm:g} mm: "
            f"its socket takes one of {2 * (room - sizes.wall_mm - sizes.clearance_mm):.1f} mm at "
            "most"
        )
    boss = boss_mm(pole, board)
    foot_stop = sizes.face_mm / 2  # above the face's plane
    base_stop = base_stop_mm(board, sizes.wall_mm)
    face_above_board = pole.length_mm - base_stop - foot_stop
    if face_above_board - sizes.wall_mm < boss:
        least = boss + sizes.wall_mm + base_stop + foot_stop
        raise InputError(
            f"a pole of {pole.length_mm:g} mm is lost in its sockets: make it longer than "
            f"{least:.0f} mm, better three times as long as the probe is wide"
        )
    axis = face[[0, 2]].mean(1)
    centre = np.array([board.width_mm, board.height_mm]) / 2
    floor = np.array([axis[0], face[1, 0], axis[1]])
    translation = np.array([*centre, -face_above_board]) - BOARD_FROM_PROBE @ floor
    return Mount(
        foot=_foot(face, collar, sizes, radius),
        base=marker_base(pole, board, wall_mm=sizes.wall_mm, clearance_mm=sizes.clearance_mm),
        board_from_probe=RigidTransform.from_numpy(BOARD_FROM_PROBE, translation),
        paper_hole_mm=paper_hole_mm(pole, wall_mm=sizes.wall_mm, clearance_mm=sizes.clearance_mm),
    )


def _foot(face: np.ndarray, collar: np.ndarray, sizes: PrintSizes, radius: float) -> PrintedPart:
    """A flange below the lowest face, a collar that plugs into it, and the pole's socket within."""
    wall, bottom = sizes.wall_mm, face[1, 0]
    axis = face.mean(1)
    flange = box(
        np.array([face[0, 0], bottom - wall, face[2, 0]]),
        np.array([face[0, 1], bottom, face[2, 1]]),
    )
    low, high = collar[:, 0] - [0, wall / 2, 0], collar[:, 1]
    hollow = np.array([wall, -wall, wall])
    tube = box(low, high) - box(low + hollow * [1, 0, 1], high - hollow)
    stop = sizes.face_mm / 2
    socket = _upright(axis, radius + wall, bottom - wall, bottom + stop + wall)
    bore = _upright(axis, radius, bottom - 2 * wall, bottom + stop)
    notch = box(
        np.array([axis[0] - _NOTCH_MM, bottom - 2 * wall, face[2, 1] - _NOTCH_MM]),
        np.array([axis[0] + _NOTCH_MM, bottom + wall, face[2, 1] + wall]),
    )
    return part_of("foot", (flange - notch) + tube + socket - bore, (0, 1, 0))


def base_stop_mm(board: MarkerBoard, wall_mm: float) -> float:
    """How far below the board's plane the pole ends."""
    return board.paper_mm + wall_mm


def paper_hole_mm(pole: Pole, *, wall_mm: float, clearance_mm: float) -> float:
    """Diameter of the hole that the base's socket needs in the paper."""
    return pole.diameter_mm + 2 * (wall_mm + 2 * clearance_mm)


def marker_base(
    pole: Pole, board: MarkerBoard, *, wall_mm: float, clearance_mm: float
) -> PrintedPart:
    """A plate with the paper's recess; its floor is two walls thick, one below the pole."""
    wall, paper, boss = wall_mm, board.paper_mm, boss_mm(pole, board)
    radius = pole.diameter_mm / 2 + clearance_mm
    size = np.array([board.width_mm, board.height_mm])
    recess = board.margin_mm + clearance_mm
    rim = recess + max(3.0, 2 * wall)
    plate = box(np.array([-rim, -rim, 0]), np.array([*(size + rim), paper + 2 * wall]))
    pocket = box(np.array([-recess, -recess, -wall]), np.array([*(size + recess), paper]))
    centre = size / 2
    notch = box(
        np.array([centre[0] - _NOTCH_MM, size[1] + rim - _NOTCH_MM, -wall]),
        np.array([centre[0] + _NOTCH_MM, size[1] + rim + wall, paper + 3 * wall]),
    )

    def cylinder(r: float, top: float, bottom: float) -> Manifold:
        # circumscribed: the flats of the polygon touch the circle, so that nothing is narrower
        outer = r / math.cos(math.pi / _SEGMENTS)
        solid = Manifold.cylinder(bottom - top, outer, outer, _SEGMENTS)
        return solid.translate((float(centre[0]), float(centre[1]), top))

    solid = plate - pocket - notch + cylinder(radius + wall, -boss, paper + wall)
    return part_of("marker_base", solid - cylinder(radius, -boss - wall, paper + wall), (0, 0, -1))


def boss_mm(pole: Pole, board: MarkerBoard) -> float:
    """Height of the base's socket above the board: two poles, which keeps it upright."""
    boss = 2 * pole.diameter_mm
    if boss > min(board.width_mm, board.height_mm) / 2:
        raise InputError(
            f"a pole of {pole.diameter_mm:g} mm hides too much of a board of {board.width_mm:g} x "
            f"{board.height_mm:g} mm: take a thinner pole or a larger board"
        )
    return boss


def _upright(axis: np.ndarray, radius: float, bottom: float, top: float) -> Manifold:
    """A cylinder along +Y; circumscribed, as in the base."""
    outer = radius / math.cos(math.pi / _SEGMENTS)
    # the cylinder's z becomes y, and its y becomes -z
    solid = Manifold.cylinder(float(top - bottom), outer, outer, _SEGMENTS).rotate((-90, 0, 0))
    return solid.translate((float(axis[0]), float(bottom), float(axis[2])))


def _check_length(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{name} must be a length above 0 mm, got {value:g}")
