"""OpenCV's lens model, and its meeting with skylight's camera."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.cameras._intrinsics import Intrinsics
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
