"""Light diffuses over a surface by the published profile, and none is made or lost."""

import math

import numpy as np
import pytest
from numpy import ndarray
from scipy.integrate import quad

from skylight.people import _subsurface as subsurface
from skylight.people._subsurface import (
    D_MM,
    DIFFUSE_MEAN_FREE_PATH_MM,
    REACH_MM,
    SkinPatches,
    patches,
    profile,
    scattered,
)

PIXEL_MM = 1.0


def share_within(r_mm: float) -> ndarray:
    """P(r): the analytic integral of the profile over a disc."""
    return 1 - np.exp(-r_mm / D_MM) / 4 - 3 * np.exp(-r_mm / (3 * D_MM)) / 4


def plane(side_mm: float) -> tuple[ndarray, SkinPatches]:
    """Pixels of 1 mm in metres, and patches of half a square millimetre on the same square."""
    half = side_mm / 2000
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    two = np.array([[0, 1, 2], [0, 2, 3]])
    middles = (np.arange(side_mm) + 0.5) / 1000 - half
    x, y = np.meshgrid(middles, middles)
    return np.stack([x, y, 0 * x], -1).reshape(-1, 3), patches(corners, two, np.arange(2), 5e-7)


def test_the_profile_is_of_the_measured_skin_and_integrates_as_its_formula_says() -> None:
    # 1 / sqrt(3 a (a + s)) of Jensen et al.'s coefficients, and that over 3.5 + 100 (A - 0.33)^4
    np.testing.assert_allclose(DIFFUSE_MEAN_FREE_PATH_MM, [3.67, 1.37, 0.68], atol=0.006)
    np.testing.assert_allclose(D_MM, [1.0451, 0.3888, 0.1865], atol=2e-4)
    for channel in range(3):

        def ring(r: float, c: int = channel) -> float:
            return 2 * math.pi * r * float(profile(np.array([r]))[0, c])

        for r in (0.3, 2.0, REACH_MM):
            within, _ = quad(ring, 1e-9, r, epsabs=1e-10)
            assert within == pytest.approx(share_within(r)[channel], abs=1e-7)
    np.testing.assert_allclose(share_within(200.0), 1, atol=1e-12)
    assert 0.03 < 1 - share_within(REACH_MM)[0] < 0.035


def test_even_light_stays_even_on_any_surface() -> None:
    rng = np.random.default_rng(0)
    pixels, flat = plane(20)
    crumpled = pixels + rng.normal(0, 1e-3, pixels.shape)
    even = np.tile([0.7, 2.0, 0.1], (len(pixels), 1))
    entering = np.tile([0.7, 2.0, 0.1], (len(flat.areas), 1))
    np.testing.assert_allclose(scattered(even, crumpled, PIXEL_MM, flat, entering), even)


def test_a_plane_keeps_its_power() -> None:
    """Of a light that ends well inside the plane."""
    pixels, flat = plane(60)

    def light(where: ndarray) -> ndarray:
        near = np.hypot(*(1000 * where[:, :2]).T) < 14
        return (near * (1 + np.sin(900 * where[:, 0])))[:, None] * np.array([1.0, 2.0, 3.0])

    entered = light(pixels)
    left = scattered(entered, pixels, PIXEL_MM, flat, light(flat.positions))
    assert np.abs(left - entered).max() > 0.2
    np.testing.assert_allclose(left.sum(0), entered.sum(0), rtol=0.01)


def test_a_point_of_light_makes_the_profile() -> None:
    pixels, flat = plane(24)
    lit = np.linalg.norm(flat.positions - [0.0003, 0.0002, 0], axis=1).argmin()
    entering = np.zeros((len(flat.areas), 3))
    entering[lit] = 1.0
    left = scattered(np.zeros(pixels.shape), pixels, PIXEL_MM, flat, entering)
    r = 1000 * np.linalg.norm(pixels - flat.positions[lit], axis=1)
    want = 1e6 * flat.areas[lit] * profile(r)
    away = (r > 1.2) & (r < 2.8)  # single patches, beyond the pixel's own disc
    np.testing.assert_allclose(left[away], want[away], rtol=1e-9)
    # further off a cluster's middle stands for it, up to 2 mm from the light
    far = (r > 6.0) & (r < 9.0)
    np.testing.assert_allclose(left[far, 0].sum(), want[far, 0].sum(), rtol=0.15)


def test_a_shadows_edge_is_the_profiles_line_integral() -> None:
    pixels, flat = plane(50)

    def light(where: ndarray) -> ndarray:
        return np.repeat((where[:, :1] > 0).astype(float), 3, 1)

    left = scattered(light(pixels), pixels, PIXEL_MM, flat, light(flat.positions))
    x = 1000 * pixels[:, 0]
    inner = np.abs(1000 * pixels[:, 1]) < 10

    def edge(distance: float, channel: int) -> float:
        """The share of light that entered beyond a line so far away (> 0)."""

        def ring(r: float) -> float:
            arc = 2 * math.acos(min(1.0, distance / r))
            return arc * r * float(profile(np.array([r]))[0, channel])

        return quad(ring, distance, REACH_MM, limit=200)[0]

    for distance in (0.5, 1.5, 3.5, 6.5):
        column = inner & (np.abs(x + distance) < 0.1)
        for channel, near in ((0, 0.02), (1, 0.02), (2, 0.03)):
            got = left[column, channel].mean()
            assert got == pytest.approx(edge(distance, channel), abs=near)
    red, green, blue = left[inner & (np.abs(x + 1.5) < 0.1)].mean(0)
    assert red > 2 * green > 4 * blue


def test_clusters_stand_for_their_patches(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a rod of 8 mm radius, half of it lit: no pixel differs by 1 % of the light."""
    angle, along = np.meshgrid(np.linspace(-np.pi, np.pi, 49), np.linspace(-0.02, 0.02, 31))
    points = np.stack([0.008 * np.sin(angle), along, 0.008 * np.cos(angle)], -1).reshape(-1, 3)
    index = np.arange(len(points)).reshape(31, 49)
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:])
    )
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    around = patches(points, faces, np.arange(len(faces)), 1e-6)
    entering = np.repeat((around.positions[:, :1] > 0).astype(float), 3, 1)
    seen = points[points[:, 2] > 0]
    own = np.repeat((seen[:, :1] > 0).astype(float), 3, 1)
    clustered = scattered(own, seen, PIXEL_MM, around, entering)
    monkeypatch.setattr(subsurface, "_NEAR_MM", 1e3)
    single = scattered(own, seen, PIXEL_MM, around, entering)
    assert 0 < np.abs(clustered - single).max() < 0.01
    # a float64 sum over all patches, well away from the pixel's own disc
    dark = seen[:, 0] < -0.002
    r = 1000 * np.linalg.norm(seen[dark, None] - around.positions[None], axis=-1)
    weight = 1e6 * around.areas[None, :, None] * profile(r.ravel()).reshape(*r.shape, 3)
    weight[r > REACH_MM] = 0
    want = np.einsum("pkc,kc->pc", weight, entering)
    np.testing.assert_allclose(single[dark], want, atol=0.01)


def test_light_from_behind_comes_round_and_a_thin_sheet_gets_no_brighter_than_its_light() -> None:
    """A sheet of 1 mm lit from behind: what the camera sees is red, and stays below the light."""
    pixels, front = plane(30)
    behind = front.positions - [0, 0, 0.001]
    both = SkinPatches(
        of_face=np.tile(front.of_face, 2),
        corners=np.tile(front.corners, (2, 1, 1)),
        positions=np.concatenate([front.positions, behind]),
        areas=np.tile(front.areas, 2),
        pixel=np.tile(front.pixel, 2),
    )
    entering = np.zeros((len(both.areas), 3))
    entering[len(front.areas) :] = 1.0
    left = scattered(np.zeros(pixels.shape), pixels, PIXEL_MM, both, entering)
    middle = np.abs(pixels[:, :2]).max(1) < 0.003
    red, green, blue = left[middle].mean(0)
    assert 1 > red > 1.2 * green > 1.5 * blue > 0
    assert red > 0.3
    entering[:] = 1.0  # twice a plane's skin is in reach, all of it lit
    most = scattered(np.zeros(pixels.shape), pixels, PIXEL_MM, both, entering).max()
    assert 0.99 < most <= 1 + 1e-9
