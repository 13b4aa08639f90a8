"""A known camera is found again; views that say too little are refused or doubted."""

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.cameras._board import Board
from skylight.probes.cameras._calibrate import calibrate, calibrate_corners
from skylight.probes.cameras._live import Frame
from skylight.probes.cameras._pose import BoardCorners
from tests.probes.cameras.conftest import VIEWS
from tests.probes.cameras.scenes import LENS, board_from_tilt

SIZE = (LENS.width, LENS.height)
Seen = list[tuple[str, BoardCorners]]


def exact(board: Board, views: list, noise: float, seed: int = 0) -> Seen:
    """Corners projected without any picture, with Gaussian noise, px."""
    generator = np.random.default_rng(seed)
    out = []
    for i, view in enumerate(views):
        rotation, translation = board_from_tilt(board, *view)
        points = board.corners()
        flat = np.stack([points[:, 0], points[:, 2], 0 * points[:, 0]], 1)
        pixels = LENS.project(flat @ rotation.T + translation)
        pixels = pixels + noise * generator.standard_normal(pixels.shape)
        numbers = np.arange(len(points))
        out.append((f"view {i}", BoardCorners(numbers=numbers, pixels=pixels, points=points)))
    return out


class TestFound:
    def test_a_known_camera_from_pictures(self, board: Board, frames: list[Frame]) -> None:
        found = calibrate(frames, board)
        lens = found.intrinsics
        assert lens.fx == pytest.approx(LENS.fx, rel=0.005)
        assert lens.fy == pytest.approx(LENS.fy, rel=0.005)
        assert (lens.cx, lens.cy) == pytest.approx((LENS.cx, LENS.cy), abs=4)
        assert lens.rms_px < 0.3
        assert len(found.views) == len(frames)
        assert found.dropped == ()
        assert found.views[0].distance_mm == pytest.approx(500, rel=0.01)
        assert found.tilt_spread_deg > 50

    def test_exact_corners_give_the_exact_camera(self, board: Board) -> None:
        lens = calibrate_corners(exact(board, VIEWS, 0.0), SIZE, board).intrinsics
        np.testing.assert_allclose(lens.matrix, LENS.matrix, rtol=2e-5, atol=1e-6)
        np.testing.assert_allclose(lens.distortion, LENS.distortion, atol=2e-4)

    def test_the_uncertainty_is_what_repetition_shows(self, board: Board) -> None:
        runs = [
            calibrate_corners(exact(board, VIEWS, 0.3, seed), SIZE, board) for seed in range(12)
        ]
        scatter = np.std([run.intrinsics.fx for run in runs], ddof=1)
        assert 0.5 < scatter / np.mean([run.std["fx"] for run in runs]) < 1.6


class TestDropped:
    def test_pictures_without_the_board_are_named(
        self, board: Board, frames: list[Frame], blank: np.ndarray
    ) -> None:
        found = calibrate([*frames[:4], Frame(name="sky.jpg", image=blank)], board)
        assert found.dropped == (("sky.jpg", "the board was not found"),)

    def test_an_outlier_is_dropped_and_named(self, board: Board) -> None:
        seen = exact(board, VIEWS, 0.1)
        name, view = seen[3]
        bent = view.pixels + 4 * np.sin(view.pixels / 40)  # a print that lay in folds
        seen[3] = (name, BoardCorners(numbers=view.numbers, pixels=bent, points=view.points))
        found = calibrate_corners(seen, SIZE, board)
        assert [name for name, _ in found.dropped] == ["view 3"]
        assert found.intrinsics.fx == pytest.approx(LENS.fx, rel=0.005)


class TestDoubts:
    def test_good_views_raise_none(self, board: Board) -> None:
        assert calibrate_corners(exact(board, VIEWS, 0.1), SIZE, board).warnings == ()

    def test_few_views(self, board: Board) -> None:
        found = calibrate_corners(exact(board, VIEWS[1:5], 0.1), SIZE, board)
        assert any("only 4 pictures" in warning for warning in found.warnings)

    def test_views_that_are_alike(self, board: Board) -> None:
        alike = [(20 + i, 15, 10 * i, [20 * i - 40, 10, 500]) for i in range(6)]
        found = calibrate_corners(exact(board, alike, 0.02), SIZE, board)
        assert found.tilt_spread_deg == pytest.approx(5.0, abs=0.3)
        assert any("tilts are within 5 degrees" in warning for warning in found.warnings)

    def test_a_board_that_stays_in_the_middle(self, board: Board) -> None:
        far = [(*view[:3], [0, 0, 1200]) for view in VIEWS]
        found = calibrate_corners(exact(board, far, 0.05), SIZE, board)
        assert found.coverage < 0.4
        assert any("distortion elsewhere is a guess" in warning for warning in found.warnings)


class TestRefused:
    def test_fewer_than_three_views(self, board: Board, frames: list[Frame]) -> None:
        with pytest.raises(InputError, match="shows in 2 of 2 pictures, and at least 3"):
            calibrate(frames[:2], board)

    def test_views_all_parallel_to_the_sensor(self, board: Board) -> None:
        flat = [(0, 0, 20 * i, [10 * i - 20, 0, 450 + 10 * i]) for i in range(4)]
        with pytest.raises(InputError, match="tilt the board"):
            calibrate_corners(exact(board, flat, 0.3), SIZE, board)

    def test_sizes_that_differ(self, board: Board, frames: list[Frame]) -> None:
        small = Frame(name="small.jpg", image=frames[1].image[::2, ::2].copy())
        with pytest.raises(InputError, match=r"small.*: 480x360"):
            calibrate([frames[0], small], board)

    def test_no_pictures(self, board: Board) -> None:
        with pytest.raises(InputError, match="no pictures"):
            calibrate([], board)
