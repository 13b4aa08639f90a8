"""The bust below a head."""

import dataclasses
import math

import numpy as np
import trimesh
from scipy.special import gamma

from skylight.faces._bust import SEMI_AXES_M, SQUARENESS, TURN, bust
from tests.sunny_face import sunny_face


def test_it_is_a_closed_superellipsoid_seen_from_outside() -> None:
    vertices, faces = bust(sunny_face(40.0, 50.0).truth)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    # Jaklic, Leonardis and Solina 2000, eq. 2.60, with e1 = e2 = e
    e = SQUARENESS

    def beta(x: float, y: float) -> float:
        return gamma(x) * gamma(y) / gamma(x + y)

    volume = 2 * np.prod(SEMI_AXES_M) * e * e * beta(e / 2 + 1, e) * beta(e / 2, e / 2)
    assert math.isclose(mesh.volume, volume, rel_tol=0.02)


def test_it_stands_upright_below_the_head_and_turns_half_as_far() -> None:
    truth = sunny_face(40.0, 50.0).truth

    def turned(yaw: float) -> np.ndarray:
        c, s = math.cos(yaw), math.sin(yaw)
        rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        return bust(dataclasses.replace(truth, rotation=rotation))[0] - truth.translation

    ahead, right = turned(0.0), turned(1.0)
    assert ahead[:, 1].max() < -0.15
    np.testing.assert_allclose(np.ptp(ahead, axis=0), 2 * SEMI_AXES_M, rtol=1e-6)
    half = TURN * 1.0
    back = np.array(
        [[math.cos(half), 0, -math.sin(half)], [0, 1, 0], [math.sin(half), 0, math.cos(half)]]
    )
    np.testing.assert_allclose(right @ back.T, ahead, atol=1e-12)
