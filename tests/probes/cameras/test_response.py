"""Response curves: named ones, and one found again from exposures."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.imaging._colour import srgb_to_linear
from skylight.probes.cameras._response import (
    Response,
    recover_response,
    saturated,
)
from tests.probes.cameras.scenes import film, srgb

RAMP = np.repeat(np.arange(256, dtype=np.uint8).reshape(16, 16, 1), 3, 2)
Encode = Callable[[np.ndarray], np.ndarray]
TIMES = [1 / 60, 1 / 30, 1 / 15, 1 / 8, 1 / 4]


def exposures(encode: Encode, noise: float = 0.7, times: list[float] = TIMES) -> list[np.ndarray]:
    """A scene of three decades of light, exposed."""
    generator = np.random.default_rng(1)
    light = np.exp(generator.uniform(np.log(0.05), np.log(50), (12, 16, 3)))
    light = np.repeat(np.repeat(light, 8, 0), 8, 1)
    out = []
    for time in times:
        share = encode(np.clip(light * time, 0, 1))
        codes = 255 * share + noise * generator.standard_normal(share.shape)
        out.append(np.clip(np.rint(codes), 0, 255).astype(np.uint8))
    return out


class TestLinearise:
    def test_srgb_and_gamma(self) -> None:
        codes = torch.from_numpy(RAMP.astype(np.float32) / 255)
        torch.testing.assert_close(Response().linearise(RAMP), srgb_to_linear(codes))
        torch.testing.assert_close(Response(kind="gamma", gamma=2.0).linearise(RAMP), codes**2)

    @pytest.mark.parametrize(
        "response",
        [
            Response(),
            Response(kind="gamma", gamma=2.2),
            Response(
                kind="curve", curve=np.stack([np.linspace(0, 5, 300) ** k for k in (1, 2, 3)])
            ),
        ],
    )
    def test_every_code_is_encoded_again(self, response: Response) -> None:
        assert (response.encode(response.linearise(RAMP)) == RAMP).all()

    def test_too_bright_and_too_dark_light_clips(self) -> None:
        light = torch.tensor([[[2.0, -1.0, 0.5]]])
        assert Response().encode(light).tolist() == [[[255, 0, 188]]]

    def test_a_curve_is_met_at_its_points_and_straight_between(self) -> None:
        curve = np.stack([np.linspace(0, 1, 256) ** k for k in (1, 2, 3)])
        found = Response(kind="curve", curve=curve).linearise(RAMP)
        np.testing.assert_allclose(found.reshape(-1, 3).numpy(), curve.T, atol=1e-6)
        deep = np.full((2, 2, 3), 257 * 100 + 128, dtype=np.uint16)  # near half way to code 101
        between = Response(kind="curve", curve=curve).linearise(deep)[0, 0].numpy()
        assert (between > curve[:, 100]).all()
        assert (between < curve[:, 101]).all()

    def test_saturated(self) -> None:
        found = saturated(RAMP).ravel()
        np.testing.assert_array_equal(np.flatnonzero(found), np.arange(250, 256))
        assert saturated(np.full((1, 1, 3), 65000, dtype=np.uint16)).all()

    def test_impossible_ones_are_refused(self) -> None:
        with pytest.raises(InputError, match="needs gamma alone"):
            Response(kind="gamma")
        with pytest.raises(InputError, match="above 0 and below 10"):
            Response(kind="gamma", gamma=-1.0)
        with pytest.raises(InputError, match="3 rows of 256"):
            Response(kind="curve", curve=np.ones((3, 20)))
        with pytest.raises(InputError, match="never fall"):
            Response(kind="curve", curve=np.ones((3, 256)) * np.linspace(1, 0.5, 256))


class TestRecovered:
    @pytest.mark.parametrize("encode", [srgb, film, lambda light: light ** (1 / 2.2)])
    def test_a_known_curve(self, encode: Encode) -> None:
        found = recover_response(exposures(encode), TIMES)
        assert found.curve is not None
        assert (np.diff(found.curve, axis=1) >= 0).all()
        light = np.linspace(0, 1, 4001)
        truth = np.interp(np.arange(256) / 255, encode(light), light)
        middle = slice(20, 246)
        ratio = found.curve[:, middle] / truth[middle]
        ratio /= np.median(ratio, axis=1, keepdims=True)
        assert np.abs(np.log(ratio)).max() < 0.06
        assert np.sqrt((np.log(ratio) ** 2).mean()) < 0.018

    def test_exposures_become_proportional(self) -> None:
        pictures = exposures(film)
        response = recover_response(pictures, TIMES)
        short, long = (response.linearise(pictures[i]).numpy() for i in (1, 3))
        usable = (pictures[1].min(-1) > 30) & ~saturated(pictures[3])
        ratio = long[usable].sum() / short[usable].sum()
        assert ratio == pytest.approx(TIMES[3] / TIMES[1], rel=0.01)

    def test_the_order_of_pictures_does_not_matter(self) -> None:
        pictures = exposures(srgb)
        forward = recover_response(pictures, TIMES).curve
        backward = recover_response(pictures[::-1], TIMES[::-1]).curve
        np.testing.assert_array_equal(forward, backward)

    def test_what_cannot_be_is_refused(self) -> None:
        pictures = exposures(srgb)
        with pytest.raises(InputError, match="do not get brighter"):
            recover_response(pictures[::-1], TIMES)
        with pytest.raises(InputError, match="one each"):
            recover_response(pictures, TIMES[:3])
        with pytest.raises(InputError, match="2 pictures"):
            recover_response(pictures[:1], TIMES[:1])
        with pytest.raises(InputError, match="above 0"):
            recover_response(pictures[:2], [0.0, 1.0])
        with pytest.raises(InputError, match="factor of 1"):
            recover_response(pictures[:2], [0.5, 0.5])
        with pytest.raises(InputError, match="of one size"):
            recover_response([pictures[0], pictures[1][:50]], TIMES[:2])
        flat = [np.full((40, 40, 3), code, dtype=np.uint8) for code in (60, 70, 80)]
        with pytest.raises(InputError, match="too few of the 256 codes of red"):
            recover_response(flat, TIMES[:3])
