"""Scattering moves light and neither makes nor loses any."""

import numpy as np

from skylight.evaluation.rendered_faces.subsurface import PROFILE, kernel, scattered

FOCAL_PX, DEPTH_M = 1000.0, 1.0  # 1 px per mm


def half_lit(size: int = 40) -> np.ndarray:
    light = np.zeros((size, size, 3))
    light[:, size // 2 :] = 1
    return light


def test_the_profile_sums_to_one_in_every_channel_and_reaches_furthest_in_red() -> None:
    np.testing.assert_allclose(sum(np.array(share) for _, share in PROFILE), 1, atol=1e-9)
    weights = kernel(1.0, 12)
    np.testing.assert_allclose(weights.sum((0, 1)), 1, atol=1e-3)
    np.testing.assert_allclose(weights, weights[::-1, ::-1], atol=1e-15)
    across = np.arange(-12, 13) ** 2
    red, green, blue = np.einsum("ijc,j->c", weights, across)
    # the profile's own variance in mm^2 (1 px is 1 mm) and that of a pixel
    variance = sum(v * np.array(share) for v, share in PROFILE)
    assert red > 5 * green > 5 * blue
    assert variance[0] < red < variance[0] + 1 / 12 + 0.05


def test_light_is_kept_and_even_light_stays_even() -> None:
    rng = np.random.default_rng(0)
    light = rng.uniform(0, 3, (30, 41, 3))
    depth = np.full((30, 41), DEPTH_M) + rng.uniform(0, 0.02, (30, 41))
    skin = rng.random((30, 41)) < 0.8
    moved = scattered(light, depth, skin, FOCAL_PX)
    np.testing.assert_allclose(moved.sum((0, 1)), light.sum((0, 1)), rtol=1e-12)
    np.testing.assert_array_equal(moved[~skin], light[~skin])
    even = np.full_like(light, 0.7)
    np.testing.assert_allclose(scattered(even, depth, skin, FOCAL_PX), even, rtol=1e-12)
    assert moved[skin][:, 0].std() < 0.8 * light[skin][:, 0].std()


def test_a_shadows_edge_gets_a_red_seam() -> None:
    light = half_lit()
    depth, skin = np.full((40, 40), DEPTH_M), np.ones((40, 40), bool)
    red, green, blue = scattered(light, depth, skin, FOCAL_PX)[20, 18]
    assert red > 0.05
    assert red > 5 * max(green, blue)


def test_nothing_crosses_a_step_in_depth_or_leaves_the_skin() -> None:
    light = half_lit()
    stepped = np.full((40, 40), DEPTH_M)
    stepped[:, 20:] += 0.05
    whole = np.ones((40, 40), bool)
    np.testing.assert_allclose(scattered(light, stepped, whole, FOCAL_PX), light, atol=1e-15)
    level = np.full((40, 40), DEPTH_M)
    dark_side = whole.copy()
    dark_side[:, 20:] = False
    np.testing.assert_allclose(scattered(light, level, dark_side, FOCAL_PX), light, atol=1e-15)
