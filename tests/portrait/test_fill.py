"""Pictures of which some pixels are known."""

import numpy as np

from skylight.portrait._gain import blurred, filled


def known_half(shape: tuple[int, int]) -> np.ndarray:
    weights = np.zeros(shape, np.float32)
    weights[:, : shape[1] // 2] = 1
    return weights


def test_what_is_known_stays_and_an_even_picture_is_filled_evenly() -> None:
    rng = np.random.default_rng(0)
    picture = rng.random((37, 53, 3)).astype(np.float32)
    weights = known_half((37, 53))
    result = filled(picture, weights)
    np.testing.assert_allclose(result[weights > 0], picture[weights > 0], atol=1e-6)
    even = np.full_like(picture, 0.7) * weights[..., None]
    np.testing.assert_allclose(filled(even, weights), 0.7, atol=1e-4)


def test_what_is_filled_lies_within_what_is_known_and_follows_what_is_near() -> None:
    picture = np.zeros((64, 64, 1), np.float32)
    picture[:32] = 1.0
    result = filled(picture, known_half((64, 64)))
    assert result.min() >= -1e-5
    assert result.max() <= 1 + 1e-5
    assert result[8, 40, 0] > 0.9
    assert result[56, 40, 0] < 0.1


def test_blurring_ignores_what_has_no_weight() -> None:
    picture = np.full((32, 32, 3), 5.0, np.float32)
    weights = known_half((32, 32))
    picture[weights == 0] = 1e6
    result = blurred(picture, weights, 3.0)
    np.testing.assert_allclose(result[:, :18], 5.0, rtol=1e-4)
