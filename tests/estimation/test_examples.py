"""The photographs to try: scikit-image's pixels, estimated by the demonstration as they are."""

from pathlib import Path

import numpy as np
import pytest
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image
from skimage.data import astronaut, camera

from skylight.estimation import _demo as demo
from skylight.estimation._examples import EXAMPLES


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
