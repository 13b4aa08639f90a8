"""Exposures of a known response and noise give back the light."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.cameras._exposures import Exposure, merge
from skylight.probes.cameras._response import Response
from tests.probes.cameras.scenes import film, srgb

TIMES = [1 / 256, 1 / 64, 1 / 16, 1 / 4, 1.0]
Encode = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def light() -> np.ndarray:
    """Blocks of four decades of light, and a gradient."""
    generator = np.random.default_rng(3)
    blocks = np.exp(generator.uniform(np.log(0.02), np.log(200), (12, 16, 1)))
    return np.kron(blocks, np.ones((8, 8, 1))) * np.array([1.0, 0.8, 0.6])


def bracket(light: np.ndarray, encode: Encode = srgb, noise: float = 0.7) -> list[Exposure]:
    generator = np.random.default_rng(1)
    out = []
    for time in TIMES:
        codes = 255 * encode(np.clip(light * time, 0, 1))
        codes = np.rint(codes + noise * generator.standard_normal(light.shape))
        image = np.clip(codes, 0, 255).astype(np.uint8)
        out.append(Exposure(name=f"{time:g}.png", seconds=time, image=image))
    return out


def error(got: torch.Tensor, light: np.ndarray) -> float:
    """Median relative error."""
    return float(np.median(np.abs(got.numpy() / light - 1)))


class TestMerge:
    def test_light_is_found_again_through_noise(self, light: np.ndarray) -> None:
        found = merge(bracket(light), "srgb")
        assert error(found.radiance, light) < 0.01
        assert np.median(found.radiance.numpy() / light) == pytest.approx(1, abs=0.002)
        assert not found.clipped.any()
        assert found.disagreement is not None
        assert found.disagreement < 0.02

    def test_order_and_unit_of_times_do_not_matter(self, light: np.ndarray) -> None:
        shots = bracket(light)
        swapped = [
            Exposure(name=s.name, seconds=1000 * s.seconds, image=s.image) for s in reversed(shots)
        ]
        torch.testing.assert_close(
            merge(shots, "srgb").radiance, merge(swapped, "srgb").radiance, rtol=1e-6, atol=0
        )

    def test_more_exposures_are_better_than_the_best_alone(self, light: np.ndarray) -> None:
        alone = Response().linearise(bracket(light)[2].image) / TIMES[2]
        assert error(merge(bracket(light), "srgb").radiance, light) < 0.35 * error(alone, light)

    def test_what_is_saturated_throughout_is_a_lower_bound_and_said(self) -> None:
        light = np.full((40, 40, 3), 0.5)
        light[10:20, 10:20] = 1000.0  # the shortest exposure saturates at 256
        found = merge(bracket(light), "srgb")
        want = np.zeros((40, 40), bool)
        want[10:20, 10:20] = True
        np.testing.assert_array_equal(found.clipped.numpy(), want)
        inside = found.radiance[10:20, 10:20]
        assert 0.95 * 256 < float(inside.min()) <= float(inside.max()) <= 256.01

    def test_a_black_place_stays_black(self) -> None:
        light = np.full((40, 40, 3), 0.5)
        light[:10] = 0
        assert float(merge(bracket(light, noise=0.0), "srgb").radiance[:10].max()) == 0

    def test_linear_files_need_no_response(self, light: np.ndarray) -> None:
        shots = [
            Exposure(name="x.exr", seconds=t, image=np.clip(light * t, 0, 1).astype(np.float32))
            for t in TIMES
        ]
        found = merge(shots)
        assert found.response is None
        np.testing.assert_allclose(found.radiance.numpy(), light, rtol=1e-5)


class TestResponse:
    def test_srgb_is_kept_where_it_explains_the_exposures(self, light: np.ndarray) -> None:
        found = merge(bracket(light))
        assert found.response == Response()
        assert "sRGB is taken" in found.notes[0]

    def test_another_curve_is_recovered(self, light: np.ndarray) -> None:
        found = merge(bracket(light, film))
        assert found.response is not None
        assert found.response.kind == "curve"
        assert "was recovered" in found.notes[0]
        # channels are related by equal middle codes alone
        scale = np.median(found.radiance.numpy() / light)
        assert error(found.radiance / scale, light) < 0.02
        wrong = merge(bracket(light, film), "srgb").radiance
        assert error(wrong / np.median(wrong.numpy() / light), light) > 0.045

    def test_a_smooth_scene_of_few_codes_falls_back_with_a_line(self) -> None:
        light = np.full((40, 40, 3), 0.002) * np.linspace(1, 1.2, 40)[:, None]
        found = merge(bracket(light))
        assert found.response == Response()
        assert "could not be recovered" in found.notes[0]

    def test_two_exposures_are_too_few(self, light: np.ndarray) -> None:
        assert "two exposures" in merge(bracket(light)[2:4]).notes[0]

    def test_a_known_response_is_used(self, light: np.ndarray) -> None:
        known = Response(kind="gamma", gamma=2.0)
        found = merge(bracket(light, np.sqrt), known)
        assert found.response == known
        assert np.median(found.radiance.numpy() / light) == pytest.approx(1, abs=0.002)


class TestRefusals:
    @pytest.mark.parametrize(
        ("count", "other", "message"),
        [
            (1, {}, "one picture"),
            (1, {"seconds": 9.0, "image": np.zeros((50, 128, 3), np.uint8)}, r"b\.png: 128x50"),
            (1, {"seconds": TIMES[0]}, "too alike"),
            (5, {"seconds": 0.0}, r"b\.png: .*time"),
            (5, {"seconds": 9.0, "image": np.ones((96, 128, 3), np.float32)}, "not both"),
        ],
        ids=["one", "size", "alike", "zero", "linear"],
    )
    def test_no_bracket(
        self, light: np.ndarray, count: int, other: dict[str, Any], message: str
    ) -> None:
        shots = bracket(light)[:count]
        if other:
            shots.append(replace(shots[0], name="b.png", **other))
        with pytest.raises(InputError, match=message):
            merge(shots)

    def test_a_scene_that_does_not_follow_its_times(self, light: np.ndarray) -> None:
        shots = bracket(light)
        images = [shots[i].image for i in (4, 1, 2, 3, 0)]
        mixed = [Exposure(name="m", seconds=t, image=i) for t, i in zip(TIMES, images, strict=True)]
        with pytest.raises(InputError, match="do not get brighter"):
            merge(mixed, "recover")
