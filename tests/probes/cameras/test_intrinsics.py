"""OpenCV's lens model, and its meeting with skylight's camera."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.cameras._intrinsics import Intrinsics, load_intrinsics, save_intrinsics
from tests.probes.cameras.scenes import LENS

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
    def test_projection_is_opencvs(self, lens: Intrinsics) -> None:
        still = np.zeros(3)
        theirs, _ = cv2.projectPoints(POINTS, still, still, lens.matrix, lens.distortion)
        np.testing.assert_allclose(lens.project(POINTS), theirs[:, 0], atol=1e-9)

    @pytest.mark.parametrize("lens", [LENS, STRONG])
    def test_undistorted_points_are_a_pinholes(self, lens: Intrinsics) -> None:
        pinhole = POINTS @ lens.matrix.T
        pinhole = pinhole[:, :2] / pinhole[:, 2:]
        np.testing.assert_allclose(lens.undistort_points(lens.project(POINTS)), pinhole, atol=1e-7)

    def test_no_points(self) -> None:
        assert LENS.project(np.zeros((0, 3))).shape == (0, 2)
        assert LENS.undistort_points(np.zeros((0, 2))).shape == (0, 2)


@pytest.mark.parametrize(
    ("width", "height", "mend"), [(50, 100, "calibrate"), (720, 960, "hold the camera")]
)
def test_pictures_of_another_size_are_refused(width: int, height: int, mend: str) -> None:
    with pytest.raises(InputError, match=mend):
        LENS.require_size(width, height)


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
