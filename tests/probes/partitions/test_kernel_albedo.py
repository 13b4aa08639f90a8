"""The albedo of a material, in drawn photos of it beside cards and charts."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.cameras._response import Response
from skylight.probes.partitions._kernel_albedo import (
    KernelAlbedo,
    albedo_beside_card,
    albedo_beside_chart,
    read_albedo,
    save_albedo,
)
from tests.drawn_chart import lay_chart

MATERIAL = np.array([0.78, 0.74, 0.66])
LAMP = np.array([0.8, 0.65, 0.5])
GAMMA = Response(kind="gamma", gamma=2.0)
PATCH = (625, 250, 100, 80)


@cache
def photo(*, stray: float = 0.0, slope: float = 0.0, brightness: float = 1.0) -> np.ndarray:
    """A chart and the material side by side on a grey table, with a pixel's noise."""
    scene = np.full((500, 750, 3), 0.25, np.float32)
    lay_chart(scene, [[50, 75], [550, 95], [540, 430], [40, 410]])
    x, y, width, height = PATCH
    scene[y - 10 : y + height + 10, x - 10 : x + width + 10] = MATERIAL
    light = scene * LAMP * brightness * (1 + slope * np.linspace(-1, 1, 750)[:, None]) + stray
    noise = 1.5 * np.random.default_rng(0).standard_normal(light.shape, dtype=np.float32)
    return np.clip(np.rint(255 * np.sqrt(light) + noise), 0, 255).astype(np.uint8)


class TestChart:
    @pytest.mark.parametrize("stray", [0.0, 0.03])
    def test_the_material_is_told_whatever_the_lamp(self, stray: float) -> None:
        found = albedo_beside_chart(photo(stray=stray), GAMMA, PATCH)
        np.testing.assert_allclose(found.rgb, MATERIAL, rtol=0.01)
        assert found.error.max() < 0.01
        assert (np.abs(found.rgb - MATERIAL) < 4 * found.error + 0.001).all()
        assert found.reference == "ColorChecker"

    def test_uneven_light_shows_in_the_error(self) -> None:
        even = albedo_beside_chart(photo(), GAMMA, PATCH)
        uneven = albedo_beside_chart(photo(slope=0.1, brightness=0.8), GAMMA, PATCH)
        assert uneven.error.min() > 3 * even.error.max()

    def test_another_response_shows_in_the_error(self) -> None:
        wrong = albedo_beside_chart(photo(), Response(kind="gamma", gamma=1.2), PATCH)
        assert wrong.error.max() > 0.02

    def test_a_white_that_clips_does_not_matter(self) -> None:
        """White alone: its albedo times the lamp is above 1, that of the material below."""
        found = albedo_beside_chart(photo(brightness=1.42), GAMMA, PATCH)
        np.testing.assert_allclose(found.rgb, MATERIAL, rtol=0.015)

    def test_no_chart(self) -> None:
        with pytest.raises(InputError, match="ColorChecker"):
            albedo_beside_chart(np.full((400, 600, 3), 90, np.uint8), GAMMA, (0, 0, 50, 50))

    def test_over_exposure(self) -> None:
        with pytest.raises(InputError, match="over-exposed"):
            albedo_beside_chart(photo(brightness=1.8), GAMMA, PATCH)


class TestCard:
    CARD = (600, 30, 125, 100)  # of the table

    def test_the_ratio_counts(self) -> None:
        found = albedo_beside_card(photo(), GAMMA, PATCH, self.CARD, 0.25)
        np.testing.assert_allclose(found.rgb, MATERIAL, rtol=0.005)
        assert (found.error > 0).all()
        assert found.error.max() < 0.005

    def test_uneven_light_shows_in_the_error(self) -> None:
        even = albedo_beside_card(photo(), GAMMA, PATCH, self.CARD, 0.25)
        uneven = albedo_beside_card(photo(slope=0.3, brightness=0.8), GAMMA, PATCH, self.CARD, 0.25)
        assert uneven.error.min() > 5 * even.error.max()

    @pytest.mark.parametrize(
        ("patch", "card", "albedo", "message"),
        [
            ((700, 250, 100, 80), CARD, 0.25, "750x500"),
            ((-1, 0, 20, 20), CARD, 0.25, "leaves"),
            (PATCH, (0, 0, 5, 40), 0.25, "card .* 8 pixels"),
            (PATCH, CARD, 0.0, "card's albedo"),
            (PATCH, CARD, 0.9, "at most 1.* grey card"),
        ],
    )
    def test_what_makes_no_sense_is_refused(self, patch, card, albedo, message):
        with pytest.raises(InputError, match=message):
            albedo_beside_card(photo(), GAMMA, patch, card, albedo)


class TestFile:
    def test_there_and_back(self, tmp_path: Path) -> None:
        made = KernelAlbedo(
            rgb=torch.from_numpy(MATERIAL),
            error=torch.from_numpy(MATERIAL / 50),
            reference="grey card",
        )
        save_albedo(tmp_path / "a.json", made)
        read = read_albedo(str(tmp_path / "a.json"))
        np.testing.assert_array_equal(read.rgb, made.rgb)
        np.testing.assert_array_equal(read.error, made.error)
        assert read.reference == made.reference

    def test_a_number_is_grey_and_sure(self) -> None:
        read = read_albedo("0.8")
        np.testing.assert_array_equal(read.rgb, 0.8)
        np.testing.assert_array_equal(read.error, 0.0)

    def test_without_a_number_it_is_white_filament(self) -> None:
        np.testing.assert_array_equal(read_albedo(None).rgb, 0.8)

    @pytest.mark.parametrize("told", ["1.2", "0", "nan", "-1"])
    def test_numbers_that_are_no_albedo(self, told: str) -> None:
        """No advice about cards to who has none."""
        with pytest.raises(InputError, match=r"above 0 and at most 1, not \(.*\)$"):
            read_albedo(told)

    def test_files_that_are_none(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="cannot read"):
            read_albedo(str(tmp_path / "none.json"))
        (tmp_path / "a.json").write_text(
            '{"kind": "kernel albedo", "format": 1, "albedo": [1, 2], "standard_error": [0, 0, 0],'
            ' "told_by": "x"}'
        )
        with pytest.raises(InputError, match="three numbers"):
            read_albedo(str(tmp_path / "a.json"))
