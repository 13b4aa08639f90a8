import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb

from skylight.errors import InputError
from skylight.imaging._colour import (
    decode_gamma,
    decode_values,
    encode_gamma,
    linear_to_srgb,
    srgb_to_linear,
    tone_map,
)


def test_srgb_of_known_codes() -> None:
    # IEC 61966-2-1 by hand: mid grey 0.5, and 18 % grey
    got = srgb_to_linear(torch.tensor([0.0, 0.04045, 0.5, 1.0], dtype=torch.float64))
    want = torch.tensor([0.0, 0.0031308, 0.21404114, 1.0], dtype=torch.float64)
    torch.testing.assert_close(got, want, atol=1e-7, rtol=0)
    grey = linear_to_srgb(torch.tensor(0.18, dtype=torch.float64))
    assert float(grey) == pytest.approx(0.46135613, abs=1e-7)


def test_srgb_is_kornias() -> None:
    values = torch.linspace(0, 1, 3 * 64 * 64).reshape(3, 64, 64)
    torch.testing.assert_close(srgb_to_linear(values), rgb_to_linear_rgb(values))
    torch.testing.assert_close(linear_to_srgb(values), linear_rgb_to_rgb(values))


def test_all_codes_survive_decoding_and_encoding() -> None:
    codes = torch.arange(256)
    linear = srgb_to_linear(codes / 255)
    assert torch.equal((255 * linear_to_srgb(linear)).round().long(), codes)


@given(st.floats(1e-5, 4.0), st.floats(1.0, 3.0))
def test_gamma_there_and_back(value: float, gamma: float) -> None:
    x = torch.tensor(value, dtype=torch.float64)
    assert float(decode_gamma(encode_gamma(x, gamma), gamma)) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize(
    "curve",
    [
        srgb_to_linear,
        linear_to_srgb,
        lambda x: encode_gamma(x, 2.2),
        lambda x: decode_gamma(x, 2.2),
    ],
)
def test_black_has_value_zero_and_a_finite_gradient(curve) -> None:
    x = torch.tensor([0.0, -0.1, 1e-9, 1.0], requires_grad=True)
    y = curve(x)
    (gradient,) = torch.autograd.grad(y.sum(), x)
    assert y[0] == 0
    assert torch.isfinite(gradient).all()


def test_curves_are_continuous_at_their_joints() -> None:
    for curve, joint in (
        (srgb_to_linear, 0.04045),
        (linear_to_srgb, 0.0031308),
        (lambda x: encode_gamma(x, 2.2), 1e-6),
    ):
        below, above = curve(torch.tensor([joint * (1 - 1e-9), joint * (1 + 1e-9)]).double())
        assert float(above - below) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("decode", [0.0, -2.2, float("nan"), float("inf")])
def test_impossible_decoding_names_the_choices(decode) -> None:
    with pytest.raises(InputError, match="srgb, linear"):
        decode_values(torch.zeros(3), decode)


def test_tone_map_puts_white_at_the_quantile() -> None:
    ramp = torch.linspace(0, 100, 1000)[:, None].expand(-1, 3).contiguous()
    shown = tone_map(ramp, quantile=0.5)
    assert shown.dtype == np.uint8
    assert (shown[500:] == 255).all()
    assert (shown[:450] < 255).all()
    # a quarter of white's light is sRGB 0.537
    assert abs(int(shown[125, 0]) - 137) <= 1


def test_tone_map_shares_a_white_and_shows_a_lone_sun() -> None:
    sky = torch.full((4, 8, 3), 0.5)
    assert (tone_map(sky, white=1.0) == 188).all()
    night = torch.zeros(10, 10, 3)
    assert (tone_map(night) == 0).all()
    night[3, 4] = 7.0
    assert (tone_map(night)[3, 4] == 255).all()
