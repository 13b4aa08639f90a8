from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.fabrication._checks import part_figures
from skylight.probes.fabrication._mount import (
    BOARD_FROM_PROBE,
    MarkerBoard,
    Mount,
    Pole,
    make_mount,
)
from skylight.probes.fabrication._parts import PrintedPart
from skylight.probes.voxel._parts import VoxelParts
from skylight.transport._rays import Raycaster


def first_hit(part: PrintedPart, start: np.ndarray, along: np.ndarray) -> float:
    caster = Raycaster(torch.from_numpy(part.vertices), torch.from_numpy(part.faces))
    hits = caster.intersect(torch.from_numpy(start)[None], torch.from_numpy(along)[None])
    return float(hits.distance[0])


def test_z_of_opencv_boards_points_into_the_board() -> None:
    """A picture of the board seen straight on: the board's axes are the camera's."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((7, 5), 25.0, 18.0, dictionary)
    picture = board.generateImage((1050, 750))
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(picture)
    objects, pixels = board.matchImagePoints(corners, ids)
    camera = np.array([[1500.0, 0, 525], [0, 1500, 375], [0, 0, 1]])
    found, turn, place = cv2.solvePnP(objects, pixels, camera, np.zeros(4))
    assert found
    np.testing.assert_allclose(cv2.Rodrigues(turn)[0], np.eye(3), atol=5e-3)
    # the origin is the pattern's top left corner: half its size to the upper left of the centre
    assert place[:2, 0] == pytest.approx([-87.5, -62.5], abs=0.5)


def test_probe_stands_upright_on_the_board(mount: Mount) -> None:
    axes = mount.board_from_probe.directions(np.eye(3))
    np.testing.assert_array_equal(axes, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # up: to the viewer
    np.testing.assert_array_equal(BOARD_FROM_PROBE, axes.T)


def test_the_pole_just_fits_between_its_stops(cross: VoxelParts, mount: Mount) -> None:
    """Measured on the meshes: along the axis, from the air between foot and base."""
    foot = mount.on_base(mount.foot)
    between = np.array([87.5, 62.5, -40.0])  # above the base's socket, below the foot
    up, down = np.array([0, 0, -1.0]), np.array([0, 0, 1.0])
    length = first_hit(foot, between, up) + first_hit(mount.base, between, down)
    assert length == pytest.approx(120, abs=1e-9)
    # and the assembled probe's lowest face is where the transform says
    lowest = mount.on_base(cross.parts[0]).bounds[1, 2]
    assert lowest == pytest.approx(float(mount.board_from_probe.translation[2]))
    assert lowest < -100


def test_sockets_clear_the_pole_all_round(mount: Mount) -> None:
    foot = mount.on_base(mount.foot)
    for part, height in ((foot, foot.bounds[1, 2] - 4), (mount.base, -4.0)):
        centre = np.array([87.5, 62.5, height])
        radii = [
            first_hit(part, centre, np.array([np.cos(a), np.sin(a), 0]))
            for a in np.linspace(0, 2 * np.pi, 57)
        ]
        assert min(radii) >= 3.15 - 1e-9
        assert max(radii) <= 3.15 * 1.001


def test_recess_holds_the_paper_with_its_surface_at_the_rim(mount: Mount) -> None:
    low, high = mount.base.bounds
    assert low[2] == -12  # the socket
    for x, depth in ((-4.0, 0.2), (10.0, 0.2), (-7.0, 0.0)):
        assert first_hit(mount.base, np.array([x, 10.0, -5]), np.array([0, 0, 1.0])) == (
            pytest.approx(5 + depth, abs=1e-9)
        )
    assert high[2] == pytest.approx(0.2 + 3.2)


def test_foot_and_base_are_sound(mount: Mount) -> None:
    for part in (mount.foot, mount.base):
        figures = part_figures(part)
        assert figures.watertight
        assert figures.consistent
        assert figures.pieces == 1
        assert figures.thinnest_mm >= 1.6 - 1e-3


def test_poles_that_do_not_fit(cross: VoxelParts) -> None:
    def make(pole: Pole, board: MarkerBoard) -> Mount:
        return make_mount(cross.mount_lattice, cross.mount_collar, cross.sizes, pole, board)

    board = MarkerBoard()
    with pytest.raises(InputError, match=r"takes one of 13\.0 mm at most"):
        make(Pole(diameter_mm=13.1, length_mm=300.0), board)
    make(Pole(diameter_mm=12.9, length_mm=300.0), board)
    with pytest.raises(InputError, match="make it longer than"):
        make(Pole(length_mm=20.0), board)
    with pytest.raises(InputError, match="hides too much"):
        make(Pole(), replace(board, height_mm=20.0))
    with pytest.raises(InputError, match="length_mm"):
        Pole(length_mm=-1.0)
    with pytest.raises(InputError, match="width_mm"):
        MarkerBoard(width_mm=float("nan"))
