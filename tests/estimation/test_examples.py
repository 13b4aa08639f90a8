"""The demonstration: its scores, and scikit-image's photographs, estimated as they are."""

from pathlib import Path

import numpy as np
import pytest
import torch
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image
from skimage.data import astronaut, camera

from skylight.estimation import _demo as demo
from skylight.estimation._examples import EXAMPLES
from skylight.sphere._envmap import EnvironmentMap


def test_they_have_the_pixels_of_their_source() -> None:
    colour, grey = (example.codes() for example in EXAMPLES)
    assert np.array_equal(colour, astronaut())
    assert all(np.array_equal(grey[..., channel], camera()) for channel in range(3))


def test_the_demonstration_estimates_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[str, UInt8[ndarray, "h w 3"]]] = []

    def estimate(folder: Path, codes: UInt8[ndarray, "h w 3"], title: str, _: object) -> None:
        assert np.array_equal(np.asarray(Image.open(folder / "photo.png")), codes)
        seen.append((title, codes))

    monkeypatch.setattr(demo, "_estimate", estimate)
    folders = demo.estimate_examples(tmp_path, lambda stage, share: None)
    assert [folder.name for folder in folders] == [example.name for example in EXAMPLES]
    assert sorted(tmp_path.iterdir()) == sorted(folders)
    for example, (title, codes) in zip(EXAMPLES, seen, strict=True):
        assert title == f"{example.name} ({example.author})"
        assert np.array_equal(codes, example.codes())


@pytest.mark.parametrize("rows", [64, 128])
def test_an_estimate_on_any_rows_is_scored_on_those_of_the_truth(rows: int) -> None:
    def lit_from(rows: int, level: float) -> EnvironmentMap:
        radiance = torch.full((rows, 2 * rows, 3), level)
        radiance[: rows // 2] *= 3
        return EnvironmentMap(radiance=radiance)

    right = demo.score(lit_from(rows, 0.2), lit_from(64, 0.2))
    assert right["rmse"] < 1e-3
    assert demo.score(lit_from(rows, 0.3), lit_from(64, 0.2))["rmse"] > 0.1
