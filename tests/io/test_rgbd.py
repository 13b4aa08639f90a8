"""High dynamic range in 8 bits: what comes back, and what does not fit."""

import numpy as np
import pytest

from skylight.io._hdr import LARGEST, encode_rgbd
from tests.oracles.rgbd import decode_rgbd


def test_colours_come_back_to_the_stated_error() -> None:
    values = np.geomspace(0.02, LARGEST, 4000)
    rgb = np.stack([values, values * 0.7, values * 0.9], -1)[None]
    again = decode_rgbd(encode_rgbd(rgb))
    error = np.abs(again - rgb)[..., 0] / rgb[..., 0]
    assert error[0, values > 0.5].max() < 0.01
    assert error.max() < 0.05


def test_codes_are_babylons() -> None:
    # its toRGBD: D = clamp(floor(255 / max) / 255), rgb = (colour D)^(1 / 2.2)
    codes = encode_rgbd(np.array([[[0.25, 0.5, 1.0], [10.0, 5.0, 2.5], [0.0, 0.0, 0.0]]]))
    assert codes[0, 0].tolist() == [round(255 * 0.25 ** (1 / 2.2)), round(255 * 0.5 ** (1 / 2.2)),
                                    255, 255]  # fmt: skip
    assert codes[0, 1, 3] == 25
    assert codes[0, 1, 0] == round(255 * (10 * 25 / 255) ** (1 / 2.2))
    assert codes[0, 2].tolist() == [0, 0, 0, 255]


def test_what_is_too_bright_is_refused() -> None:
    with pytest.raises(ValueError, match="300"):
        encode_rgbd(np.full((1, 1, 3), 300.0))
