"""Brackets of RAW files and of 16-bit pictures become linear light; dark exposures are welcome."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import DependencyError, InputError
from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._photo import read_photo
from skylight.probes.cameras._exposure_files import read_exposure, read_series, response_of
from skylight.probes.cameras._response import Response, save_response
from tests.imaging.picture_files import as_depth, scene, write_png
from tests.imaging.test_raw import COLOUR, WHITE, mosaic, write_dng

RATES = (100, 400, 1600, 100_000)


def raw_bracket(folder: Path) -> list[Path]:
    """Of one colour and a white square, twice as bright as saturates the longest; one is black."""
    light = mosaic().astype(float)
    light[20:30, 40:50] = 2 * WHITE
    made = []
    for rate in RATES:
        codes = np.minimum(np.rint(light * RATES[0] / rate), WHITE).astype(np.uint16)
        if rate == RATES[-1]:
            codes[:] = 0
        made.append(write_dng(folder / f"{rate}.dng", codes, rate=rate))
    return made


def test_raw_files_by_their_own_times(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    found = read_series(raw_bracket(tmp_path), None, "auto")
    assert found.seconds == pytest.approx([1 / rate for rate in RATES])
    assert found.merged.response is None
    expected = torch.from_numpy(COLOUR / WHITE).float()
    area = found.merged.radiance[4:14, 4:30]
    torch.testing.assert_close(area, expected.expand(10, 26, 3), atol=0, rtol=0.01)
    square = found.merged.radiance[23:27, 43:47]
    torch.testing.assert_close(square, torch.full((4, 4, 3), 2.0), atol=0, rtol=0.01)
    assert not found.merged.clipped.any()


def test_what_the_shortest_raw_file_clips_is_told(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    (longest, *_) = raw_bracket(tmp_path)
    found = read_series([longest], [0.01], "auto", lone=True)
    assert found.merged.clipped[20:30, 40:50].all()
    # and neighbours that demosaicing spreads it to
    assert found.merged.clipped.sum() == 12 * 12
    assert (found.merged.radiance[20:30, 40:50].amax(-1) >= 1).all()


def test_without_rawpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(DependencyError, match=r"pip install 'skylight-lighting\[raw\]'"):
        read_series(raw_bracket(tmp_path), None, "auto")


def save_deep(path: Path, light: np.ndarray, gamma: float | None = None) -> Path:
    share = np.clip(light, 0, 1)
    coded = (
        linear_to_srgb(torch.from_numpy(share)).numpy() if gamma is None else share ** (1 / gamma)
    )
    assert cv2.imwrite(str(path), np.rint(65535 * coded[..., ::-1]).astype(np.uint16))
    return path


class TestSixteenBits:
    LIGHT = np.random.default_rng(0).uniform(0.001, 4.0, (40, 50, 3))
    TIMES = (1e-7, 0.1, 1.0)  # the first is black

    @pytest.mark.parametrize("gamma", [None, 1.0, 1.8])
    def test_they_are_as_exact_as_their_codes(self, gamma: float | None, tmp_path: Path) -> None:
        files = [
            save_deep(tmp_path / f"{k}.png", self.LIGHT * time, gamma)
            for k, time in enumerate(self.TIMES)
        ]
        response = "auto"
        if gamma is not None:
            response = str(tmp_path / "response.json")
            save_response(response, Response(kind="gamma", gamma=gamma))
        found = read_series(files, self.TIMES, response_of(response))
        got = found.merged.radiance.numpy()
        np.testing.assert_allclose(got, self.LIGHT, rtol=2e-3, atol=2e-4)
        assert not found.merged.clipped.any()

    def test_a_curve_is_for_eight_bits(self, tmp_path: Path) -> None:
        files = [save_deep(tmp_path / f"{k}.png", self.LIGHT * (k + 1) / 9) for k in range(2)]
        with pytest.raises(InputError, match="is for 8 bits"):
            read_series(files, [1.0, 2.0], "recover")


@pytest.mark.parametrize("depth", [8, 16])
def test_declared_colours_are_converted_but_for_a_curve_of_ones_own(
    tmp_path: Path, depth: int
) -> None:
    """Codes of Display P3, told by a PNG's code points; a curve is of the codes as they are."""
    codes = as_depth(scene(), depth)
    path = write_png(tmp_path / "a.png", codes, chunks={b"cICP": bytes([12, 13, 0, 1])})
    photo = read_photo(path)
    assert np.abs(photo.encoded.astype(int) - scene()).max() > 10
    seen = read_exposure(path, "srgb")
    np.testing.assert_array_equal(seen, photo.encoded if depth == 8 else photo.pixels)
    own = read_exposure(path, Response(kind="gamma", gamma=2.0))
    if depth == 8:
        np.testing.assert_array_equal(own, codes)
        np.testing.assert_array_equal(read_exposure(path, "recover"), codes)
    else:
        np.testing.assert_allclose(own, (codes / 65535) ** 2, rtol=1e-5)
