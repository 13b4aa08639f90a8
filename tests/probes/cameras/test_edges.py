"""A cube's edges mend a pose that is slightly off, and leave it alone where they cannot."""

from itertools import product

import cv2
import numpy as np
import pytest
import torch

from skylight.probes.cameras._edges import refine_on_edges
from skylight.probes.cameras._intrinsics import FLIP
from skylight.probes.cameras._pose import camera_centre, project
from skylight.sphere._rotation import RigidTransform
from tests.probes.cameras.scenes import LENS, picture_of_box

SIDE = 120.0
TURN = cv2.Rodrigues(np.array([0.55, 0.0, 0.0]))[0] @ cv2.Rodrigues(np.array([0, 0.6, 0.0]))[0]
SHIFT = np.array([10.0, -20.0, 500.0]) - TURN @ np.full(3, SIDE / 2)
TRUTH = RigidTransform.from_numpy(FLIP @ TURN, FLIP @ SHIFT)


def cube_edges() -> np.ndarray:
    corners = np.array(list(product([0.0, SIDE], repeat=3)))
    pairs = [
        (a, b) for a in corners for b in corners if (b - a).sum() == SIDE and (a != b).sum() == 1
    ]
    return np.array(pairs)


def visible(edges: np.ndarray) -> np.ndarray:
    """An edge of a convex body shows where one of its two sides faces the camera."""
    out = []
    for a, b in edges:
        fixed = np.flatnonzero(a == b)
        towards = camera_centre(TRUTH) - a
        out.append(any(towards[i] * (1 if a[i] > 0 else -1) > 0 for i in fixed))
    return np.array(out)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return picture_of_box(LENS, TURN, SHIFT, side_mm=SIDE)


def off_by(turn_deg: float, shift_mm: float, seed: int) -> RigidTransform:
    """The true pose, turned about the cube's middle and shifted, at random."""
    generator = np.random.default_rng(seed)
    axis, way = generator.standard_normal((2, 3))
    turn = np.radians(turn_deg) * axis / np.linalg.norm(axis)
    motion = np.concatenate([turn, shift_mm * way / np.linalg.norm(way)])
    middle = TRUTH.points(torch.full((3,), SIDE / 2, dtype=torch.float64))
    return RigidTransform.from_vector(torch.from_numpy(motion)).about(middle) @ TRUTH


def error_px(pose: RigidTransform) -> float:
    """Root mean square over the cube's corners."""
    corners = cube_edges().reshape(-1, 3)
    miss = project(corners, pose, LENS) - project(corners, TRUTH, LENS)
    return float(np.sqrt((miss**2).sum(1).mean()))


@pytest.mark.parametrize("seed", range(6))
def test_a_pose_that_is_off_is_mended(image: np.ndarray, seed: int) -> None:
    start = off_by(0.8, 1.5, seed)
    assert error_px(start) > 1.0
    edges = cube_edges()
    found = refine_on_edges(image, start, LENS, edges, visible(edges))
    assert found.converged, found.reason
    assert error_px(found.pose) < 0.12
    assert error_px(found.pose) < 0.1 * error_px(start)
    assert (found.pose @ TRUTH.inverse()).angle_deg < 0.1
    middle = np.full((1, 3), SIDE / 2)
    assert np.linalg.norm(found.pose.points(middle) - TRUTH.points(middle)) < 0.5
    assert found.rms_px < 0.3


def test_the_true_pose_stays(image: np.ndarray) -> None:
    edges = cube_edges()
    found = refine_on_edges(image, TRUTH, LENS, edges, visible(edges))
    assert found.converged
    assert found.moved_px < 0.1


def test_a_third_of_wrong_edges_is_borne(image: np.ndarray) -> None:
    edges = cube_edges()
    wrong = edges[:4] + np.array([7.0, -6.0, 5.0])  # edges that are not there
    found = refine_on_edges(
        image,
        off_by(0.4, 0.8, 1),
        LENS,
        np.concatenate([edges, wrong]),
        np.concatenate([visible(edges), np.ones(4, dtype=bool)]),
    )
    assert found.converged, found.reason
    assert error_px(found.pose) < 0.3


class TestKept:
    def test_no_edges_in_the_picture(self) -> None:
        blank = np.full((LENS.height, LENS.width, 3), 100, dtype=np.uint8)
        start, edges = off_by(0.5, 1.0, 0), cube_edges()
        found = refine_on_edges(blank, start, LENS, edges, visible(edges))
        assert not found.converged
        assert found.pose is start
        assert "only 0 places" in found.reason

    def test_noise_alone(self) -> None:
        generator = np.random.default_rng(0)
        noise = generator.integers(0, 255, (LENS.height, LENS.width, 3)).astype(np.uint8)
        start, edges = off_by(0.5, 1.0, 0), cube_edges()
        found = refine_on_edges(noise, start, LENS, edges, visible(edges))
        assert not found.converged
        assert found.pose is start

    def test_edges_of_one_direction_leave_a_motion_undetermined(self, image: np.ndarray) -> None:
        edges = cube_edges()
        seen = visible(edges) & (np.abs(edges[:, 1] - edges[:, 0])[:, 1] > 0)
        seen[np.flatnonzero(seen)[1:]] = False
        found = refine_on_edges(image, TRUTH, LENS, edges, seen)
        assert not found.converged
        assert "undetermined" in found.reason or "places on edges" in found.reason

    def test_nothing_visible(self, image: np.ndarray) -> None:
        edges = cube_edges()
        found = refine_on_edges(image, TRUTH, LENS, edges, np.zeros(len(edges), dtype=bool))
        assert not found.converged
