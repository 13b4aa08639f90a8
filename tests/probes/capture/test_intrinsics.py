"""OpenCV's lens model, and its meeting with skylight's camera."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.capture.intrinsics import (
    FLIP,
    PIXEL_SHIFT,
    Intrinsics,
    load_intrinsics,
    save_intrinsics,
)
from tests.probes.capture.scenes import LENS

POINTS = np.array([[0.0, 0, 500], [120, -80, 400], [-150, 100, 450], [60, 130, 700]])
STRONG = replace(LENS, k1=-0.3, k2=0.12, k3=-0.02)


class TestModel:
    def test_projection_is_the_formula(self) -> None:
        x, y = (POINTS[:, :2] / POINTS[:, 2:]).T
        r2 = x * x + y * y
        c = 1 + STRONG.k1 * r2 + STRONG.k2 * r2**2 + STRONG.k3 * r2**3
        u = STRONG.fx * (x * c + 2 * STRONG.p1 * x * y + STRONG.p2 * (r2 + 2 * x * x)) + STRONG.cx
        v = STRONG.fy * (y * c + STRONG.p1 * (r2 + 2 * y * y) + 2 * STRONG.p2 * x * y) + STRONG.cy
        np.testing.assert_allclose(STRONG.project(POINTS), np.stack([u, v], 1), atol=1e-9)

    @pytest.mark.parametrize("lens", [LENS, STRONG])
    def test_undistorted_points_are_a_pinholes(self, lens: Intrinsics) -> None:
        pinhole = POINTS @ lens.matrix.T
        pinhole = pinhole[:, :2] / pinhole[:, 2:]
        np.testing.assert_allclose(lens.undistort_points(lens.project(POINTS)), pinhole, atol=1e-7)

    def test_no_points(self) -> None:
        assert LENS.project(np.zeros((0, 3))).shape == (0, 2)
        assert LENS.undistort_points(np.zeros((0, 2))).shape == (0, 2)


class TestSkylightsCamera:
    def test_an_undistorted_picture_shows_points_where_that_camera_sees_them(self) -> None:
        image = np.zeros((LENS.height, LENS.width, 3), dtype=np.uint8)
        for u, v in LENS.project(POINTS):
            y, x = np.mgrid[: LENS.height, : LENS.width]
            spot = 255 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 3.0**2))
            image = np.maximum(image, spot[..., None].astype(np.uint8))
        flat, camera = LENS.undistorted(image)
        seen = camera.project(torch.from_numpy(POINTS @ FLIP)).numpy() - PIXEL_SHIFT
        for u, v in seen:
            row, column = round(v), round(u)
            patch = flat[row - 9 : row + 10, column - 9 : column + 10, 0].astype(float)
            y, x = np.mgrid[row - 9 : row + 10, column - 9 : column + 10]
            assert (x * patch).sum() / patch.sum() == pytest.approx(u, abs=0.1)
            assert (y * patch).sum() / patch.sum() == pytest.approx(v, abs=0.1)

    def test_linear_pictures_keep_their_type(self) -> None:
        image = np.full((LENS.height, LENS.width, 3), 0.5, dtype=np.float32)
        flat, _ = LENS.undistorted(image)
        assert flat.dtype == np.float32
        assert flat[300:400, 400:500].mean() == pytest.approx(0.5)

    @pytest.mark.parametrize(
        ("shape", "mend"), [((100, 50, 3), "calibrate"), ((960, 720, 3), "hold the camera")]
    )
    def test_another_size_is_refused(self, shape: tuple[int, ...], mend: str) -> None:
        with pytest.raises(InputError, match=mend):
            LENS.undistorted(np.zeros(shape, dtype=np.uint8))


class TestFile:
    def test_there_and_back(self, tmp_path: Path) -> None:
        save_intrinsics(tmp_path / "a.json", LENS)
        assert load_intrinsics(tmp_path / "a.json") == LENS

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"fx": "wide"}, '"fx" must be a number'),
            ({"fx": -3.0}, "above 0"),
            ({"fx": 90.0}, "differ too much"),
            ({"width": 1.5}, '"width"'),
            ({"kind": "board"}, "no camera intrinsics file"),
            ({"k1": None}, '"k1"'),
        ],
    )
    def test_impossible_values_are_refused(
        self, tmp_path: Path, change: dict, message: str
    ) -> None:
        path = tmp_path / "a.json"
        save_intrinsics(path, LENS)
        path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
        with pytest.raises(InputError, match=message):
            load_intrinsics(path)

    def test_missing_and_unreadable_files(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="cannot read"):
            load_intrinsics(tmp_path / "none.json")
        (tmp_path / "b.json").write_text("{")
        with pytest.raises(InputError, match="no JSON"):
            load_intrinsics(tmp_path / "b.json")
        (tmp_path / "c.json").write_text('{"kind": "camera intrinsics"}')
        with pytest.raises(InputError, match="missing"):
            load_intrinsics(tmp_path / "c.json")

    def test_opencv_agrees_on_the_order_of_distortion(self) -> None:
        out, _ = cv2.projectPoints(
            POINTS, np.zeros(3), np.zeros(3), STRONG.matrix, STRONG.distortion
        )
        np.testing.assert_allclose(out.reshape(-1, 2), STRONG.project(POINTS))
