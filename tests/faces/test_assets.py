"""The files that come with the package: what is missing or damaged is named, with what to do."""

import re
from pathlib import Path

import pytest

from skylight.errors import AssetError
from skylight.faces import _blazeface, _landmarks, _mediapipe, _model, _skin
from skylight.people import _skin as painted

FILES = {
    "face_detector.onnx": (_blazeface, lambda: _blazeface.Network("face_detector")),
    "head.npz": (_landmarks, _model.HeadModel.load.__wrapped__),
    "dlib_landmarks.npz": (_landmarks, _model._whitening.__wrapped__),
    "mediapipe_landmarks.npz": (_landmarks, _model._mesh_moment.__wrapped__),
    "mirrored_points.npy": (_mediapipe, _mediapipe._mirrored_points.__wrapped__),
    "skin_prior.safetensors": (_skin, _skin.SkinPrior.load.__wrapped__),
    "skin_colours.npz": (_landmarks, painted.skin_colour.__wrapped__),
}


@pytest.mark.parametrize("kept", [None, 0, 200])
@pytest.mark.parametrize("name", FILES)
def test_a_missing_or_damaged_file_is_named(
    name: str, kept: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, load = FILES[name]
    (data := tmp_path / "data").mkdir()
    if kept is not None:
        package = painted if name == "skin_colours.npz" else _skin
        whole = Path(package.__file__).parent / "data" / name
        (data / name).write_bytes(whole.read_bytes()[:kept])
    monkeypatch.setattr(module, "files", lambda _: tmp_path)
    with pytest.raises(AssetError, match=rf"{re.escape(name)}.*(reinstall skylight|again)"):
        load()
