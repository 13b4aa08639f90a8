"""Photographs of people: with captured light (Table 5.3), or with notes on its side."""

import json
import shutil
from dataclasses import replace

import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation._main import EVALUATIONS, run_evaluation
from skylight.evaluation._real_faces import (
    INDEX,
    CapturedFaces,
    RealFaces,
    _read_index,
    aligned_scores,
    side_of_light,
)
from skylight.evaluation._run import picture_of
from skylight.evaluation._tables import METRICS
from skylight.faces._captures import FaceCapture, write_azimuths
from skylight.sphere._envmap import EnvironmentMap
from tests.evaluation.quick import QUICK
from tests.face_captures import PHOTO, TURNS_DEG

CAPTURE = FaceCapture(photo="a", probe="b", azimuth_deg=0.0, visible_sun=True, person="Ada")


@pytest.fixture
def calibrated(face_captures, tmp_path):
    shutil.copytree(face_captures.folder, tmp_path / "faces")
    write_azimuths(tmp_path / "faces", TURNS_DEG)
    return tmp_path / "faces"


@pytest.fixture
def lights():
    generator = torch.Generator().manual_seed(2)
    two = [torch.rand(64, 128, 3, generator=generator) ** 3 for _ in range(2)]
    return tuple(EnvironmentMap(radiance=radiance) for radiance in two)


@pytest.mark.slow
def test_exposures_of_photograph_and_probe_do_not_matter(lights):
    estimate, truth = lights
    scores = aligned_scores(estimate, truth, CAPTURE)
    assert set(METRICS) <= set(scores)
    brighter = aligned_scores(EnvironmentMap(radiance=20 * estimate.radiance), truth, CAPTURE)
    assert brighter == pytest.approx(scores, rel=1e-3, abs=1e-5)


def test_without_a_visible_sun_nothing_is_said_of_it(lights):
    estimate, truth = lights
    scores = aligned_scores(estimate, truth, replace(CAPTURE, visible_sun=False))
    assert not any(name.startswith("sun_") for name in scores)
    assert {"mae", "rmse", "si_rmse", "full_dw_mae", "sky_dw_mae"} <= set(scores)


def test_captures_without_azimuth_are_refused(face_captures):
    with pytest.raises(InputError, match=r"2 of .* azimuth_deg"):
        CapturedFaces(data=face_captures.folder)


def test_a_folder_of_captures_is_recognised(calibrated):
    chosen = EVALUATIONS["real-faces"].over(calibrated, quick=True)
    assert chosen == CapturedFaces(data=calibrated, every=3)


def test_a_new_azimuth_or_probe_makes_old_results_stale(calibrated):
    evaluation = CapturedFaces(data=calibrated)
    seen = [evaluation.config()]
    write_azimuths(calibrated, {PHOTO: 0.0})
    seen.append(evaluation.config())
    shutil.copy(calibrated / "day/ada.exr", calibrated / "day/bob.exr")
    seen.append(evaluation.config())
    assert seen[0] != seen[1] != seen[2]


@pytest.mark.slow
def test_the_table(calibrated, tmp_path):
    evaluation = CapturedFaces(data=calibrated, methods=("sh9", "sunsky"), every=2, options=QUICK)
    path = run_evaluation(evaluation, tmp_path / "out", command="c")
    results = json.loads(path.read_text())
    assert results["problems"] == {}
    row = results["rows"]["sh9"]
    assert {name: row[name]["n"] for name in METRICS} == dict.fromkeys(METRICS, 1)
    # against the probe as it lies in its file, a turn of 110 degrees away, it would be far more
    assert row["sun_angle_deg"]["mean"] < 40
    assert row["si_rmse"]["mean"] < 0.3
    assert results["items"][PHOTO]["person"] == "Ada"
    assert picture_of(tmp_path / "out", PHOTO).is_file()
    text = (tmp_path / "out" / "results.md").read_text()
    assert "Table 5.3" in text
    assert "45.88 ± 46.72" in text


@pytest.mark.slow
def test_real_faces(tmp_path, shared_data):
    folder = tmp_path / "photos"
    folder.mkdir()
    name = "gov03.jpg"
    (folder / name).write_bytes((shared_data / "faces" / name).read_bytes())
    entry = {"light": "sun-hard", "desc": "warm hard sun from viewer's right front above"}
    (folder / "index.json").write_text(json.dumps({name: entry}))
    path = run_evaluation(RealFaces(data=folder), tmp_path / "out", command="c")
    results = json.loads(path.read_text())
    assert results["items"][name]["side"] == "right"
    assert results["rows"]["sphere"]["finite"]["mean"] == 1
    assert results["rows"]["sphere"]["right_side"]["n"] == 1


@pytest.mark.parametrize(
    ("note", "side"),
    [
        ("hard sun from viewer's left and above, right half nearly black", "left"),
        ("direct light from front/upper left, deep shadow under brow and at right", "left"),
        ("outdoor, soft light from viewer's right; 3/4 view", "right"),
        ("soft key from front, slightly viewer's right", "right"),
        ("window light front/left plus back rim", "left"),
        ("direct light from the front and above; both cheeks lit, left one brighter", "left"),
        ("soft directional light, right cheek and neck darker", "left"),
        ("hard low sun: lit left jaw and neck, hair glow", "left"),
        ("bright light from viewer's right, bluish fill at left", "right"),
        # none, both, or from behind
        ("soft frontal light; cap, right edge partly occluded", None),
        ("hair over left", None),
        ("key from viewer's left plus rim from the right", None),
        ("soft light with two sides: left cheek brighter", None),
        ("sun behind viewer's right on the hair", None),
        ("", None),
    ],
)
def test_side_of_light(note, side):
    assert side_of_light(note) == side


def test_a_mirrored_note_names_the_other_side():
    note = "sun from viewer's left: lit left cheek, right side darker"
    swapped = note.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right")
    assert (side_of_light(note), side_of_light(swapped)) == ("left", "right")


@pytest.mark.parametrize("index", ["[1]", '{"a.jpg": "front"}'])
def test_an_index_of_another_form_is_refused(tmp_path, index):
    (tmp_path / INDEX).write_text(index)
    with pytest.raises(InputError, match=r"expected \{\"photo.jpg\""):
        _read_index(tmp_path)
