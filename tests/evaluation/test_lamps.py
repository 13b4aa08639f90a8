"""Tests for skylight.evaluation._lamps."""

import json
import math

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation import _lamps as lamps
from skylight.evaluation._lamps import Lamps, read_lamp_photo
from skylight.evaluation._run import Item, measure_all
from skylight.faces._synthetic import render_face
from skylight.sphere._envmap import EnvironmentMap
from tests.evaluation.quick import QUICK


def index(folder, content):
    (folder / "lamps.json").write_text(json.dumps(content))


def test_grey_linear_codes_come_back_as_light_of_skins_hue(tmp_path):
    grey = np.tile(np.arange(20, 250, 5, dtype=np.uint8), (40, 1))
    cv2.imwrite(str(tmp_path / "a_1.png"), grey)
    photo = read_lamp_photo(tmp_path / "a_1.png")
    level = torch.from_numpy(grey).float() / 255
    hue = torch.tensor(lamps.SKIN_TINT)
    assert photo.pixels / hue == pytest.approx(level[..., None].expand(-1, -1, 3), rel=0.02)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({}, "expected"),
        ({"a_1.png": [0.0, 0.0, 2.0]}, "unit vector"),
        ({"a_1.png": "up"}, "unit vector"),
        ({"a_1.png": [0.0, 1.0]}, "unit vector"),
    ],
)
def test_an_index_without_directions_is_refused(tmp_path, content, said):
    index(tmp_path, content)
    lamps.lamp_index.cache_clear()
    with pytest.raises(InputError, match=said):
        Lamps(data=tmp_path)


def test_a_picture_without_a_face_is_not_found(tmp_path):
    index(tmp_path, {"a_1.png": [0.0, 0.0, 1.0]})
    grey = np.random.default_rng(0).integers(0, 255, (96, 96)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a_1.png"), grey)
    lamps.lamp_index.cache_clear()
    evaluation = Lamps(data=tmp_path)
    (item,) = measure_all(evaluation, tmp_path / "out", workers=1)
    assert "no face found" in item.problem
    assert not evaluation.checks({}, [item])["faces found"].ok


def at(azimuth_deg, elevation_deg):
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    vector = [math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)]
    return torch.tensor(vector, dtype=torch.float64)


def test_errors_are_those_of_azimuth_and_elevation():
    found = lamps.lamp_errors(at(35, 52), at(20, 40))
    assert found["azimuth_deg"] == pytest.approx(15)
    assert found["elevation_deg"] == pytest.approx(12)
    level = lamps.lamp_errors(at(170, 0), at(-175, 0))
    assert level["azimuth_deg"] == pytest.approx(-15)  # the short way round
    assert level["angle_deg"] == pytest.approx(15)


def person(name, pitch_deg):
    return Item(name=name, metrics={}, facts={"person": name, "pitch_deg": pitch_deg})


def test_pitch_is_judged_within_and_over_people():
    items = [person("a", p) for p in (1.0, 3.0)] + [person("b", p) for p in (-9.0, -9.0, -9.0)]
    checks = lamps._pose_checks(items)
    assert checks["pitch scatters within a person by"].value == pytest.approx(0.5)
    assert checks["median pitch of all people"].value == pytest.approx(3.5)
    worst = checks["largest median pitch of a person"]
    assert worst.value == pytest.approx(9)
    assert not worst.ok


@pytest.mark.slow
def test_every_part_left_out_has_a_row(tmp_path):
    light = np.full((8, 16, 3), 0.05, np.float32)
    light[2, 0] = 20  # behind the camera, to the right
    sky = EnvironmentMap(radiance=torch.from_numpy(light))
    person = render_face(
        sky, torch.tensor([0.1, 0.1, 0.1]), seed=3, size=144, azimuth_rad=0.0, light_rows=8
    )
    grey = (255 * person.picture[..., 1] / person.picture[..., 1].max()).byte().numpy()
    cv2.imwrite(str(tmp_path / "a_1.png"), grey)
    lamp = person.environment.brightest_direction()
    index(tmp_path, {"a_1.png": lamp.tolist()})
    lamps.lamp_index.cache_clear()
    evaluation = Lamps(data=tmp_path, ablation=True, options=QUICK)
    item = evaluation.measure("a_1.png", tmp_path / "picture.png")
    parts = ("_balanced", "_varying_skin", "_trusted_normals", "_68_points")
    names = {lamps.OURS + name for name in ("", *parts)}
    assert names <= set(item.metrics)
    assert item.metrics["autoencoder"]["angle_deg"] < 15
    others = [item.metrics[name]["angle_deg"] for name in names]
    assert len(set(others)) > 2  # what is left out matters
