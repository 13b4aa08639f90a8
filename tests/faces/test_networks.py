"""The networks of faces, run by onnxruntime."""

import numpy as np
import pytest

from skylight.errors import AssetError
from skylight.faces import _blazeface as networks
from skylight.faces._blazeface import Network, network


@pytest.mark.parametrize(
    ("name", "side", "channels", "sizes"),
    [
        ("face_detector", 128, 3, [896 * 16, 896]),
        ("face_landmarks", 256, 3, [478 * 3, 1, 1]),
        ("hair_segmenter", 512, 4, [512 * 512 * 2]),
    ],
)
def test_what_goes_in_and_out(name, side, channels, sizes):
    made = network(name)
    assert made.side == side
    picture = np.random.default_rng(0).random((side, side, channels), dtype=np.float32)
    outputs = made.run(picture)
    assert [output.size for output in outputs] == sizes
    assert all(np.isfinite(output).all() for output in outputs)
    assert outputs[0].std() > 0


def test_it_is_loaded_once():
    assert network("face_detector") is network("face_detector")


@pytest.mark.parametrize("content", [None, b"", b"no network"])
def test_a_missing_or_damaged_file_is_told(tmp_path, monkeypatch, content):
    folder = tmp_path / "data"
    folder.mkdir()
    if content is not None:
        (folder / "face_detector.onnx").write_bytes(content)
    monkeypatch.setattr(networks, "files", lambda _: tmp_path)
    with pytest.raises(AssetError, match=r"face_detector\.onnx.*reinstall"):
        Network("face_detector")
