"""Faces by name: what makes earlier results stale, which have scenes; and their scores."""

import json
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation._known_faces import FaceSource
from skylight.inverse._scores import score
from skylight.models.sunsky import SunSky
from skylight.sphere._envmap import EnvironmentMap


def folder_of(path: Path, number: int) -> Path:
    """Facts and pictures (any bytes) of so many faces."""
    for i in range(number):
        face = path / f"face{i:04d}"
        face.mkdir(parents=True)
        (face / "face.json").write_text(json.dumps({"scene": i // 4}))
        (face / "picture.png").write_bytes(bytes([i]))
    return path


def test_the_same_faces_elsewhere_are_the_same(tmp_path):
    here, there = (FaceSource(data=folder_of(tmp_path / n, 2), count=None) for n in ("a", "b"))
    assert here.config() == there.config()


@pytest.mark.parametrize("part", ["face.json", "picture.png"])
def test_another_fact_or_picture_makes_old_results_stale(tmp_path, part):
    source = FaceSource(data=folder_of(tmp_path, 2), count=None)
    before = source.config()
    (tmp_path / "face0001" / part).write_bytes(b'{"scene": 7}')
    assert source.config() != before


def test_only_the_faces_that_are_taken_count(tmp_path):
    source = FaceSource(data=folder_of(tmp_path, 2), count=1)
    before = source.config()
    (tmp_path / "face0001" / "picture.png").write_bytes(b"another")
    assert source.config() == before
    assert FaceSource(data=tmp_path, count=2).config() != before


def test_a_face_without_a_picture_is_named(tmp_path):
    (folder_of(tmp_path, 1) / "face0000" / "picture.png").unlink()
    with pytest.raises(InputError, match="face0000"):
        FaceSource(data=tmp_path, count=None).config()


def test_only_a_folders_faces_have_scenes(tmp_path, monkeypatch):
    assert FaceSource(data=folder_of(tmp_path, 5), count=None).scene("face0004") == 1
    monkeypatch.chdir(tmp_path)  # whose faces are nobody's
    with pytest.raises(InputError, match="folder"):
        FaceSource(data=None, count=1).scene("face0000")


@pytest.fixture(scope="module")
def sky():
    model = SunSky()
    return model(model.starts()[:1])[0].reshape(*model.grid.layout, 3)


def test_the_truth_scores_perfectly(sky):
    truth = EnvironmentMap(radiance=sky).with_ground(torch.tensor([0.1, 0.1, 0.1]))
    scores = score(truth, truth, sun_visible=True)
    assert scores["ssim"] == pytest.approx(1, abs=1e-5)
    assert scores["brightness"] == pytest.approx(1)
    errors = {k: v for k, v in scores.items() if k not in ("ssim", "brightness")}
    assert errors == pytest.approx(dict.fromkeys(errors, 0), abs=1e-4)


def test_brightness_alone_is_seen_by_brightness_alone(sky):
    truth = EnvironmentMap(radiance=sky).with_ground(torch.tensor([0.1, 0.1, 0.1]))
    scores = score(EnvironmentMap(radiance=3 * truth.radiance), truth, sun_visible=False)
    assert scores["brightness"] == pytest.approx(3, rel=1e-5)
    assert scores["mae"] == pytest.approx(2, rel=1e-5)
    assert scores["mae_aligned"] == pytest.approx(0, abs=1e-5)
    assert not any(name.startswith("sun_") for name in scores)
