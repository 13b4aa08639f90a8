"""Table 5.3 on a folder of captures."""

import json
import shutil
from dataclasses import replace

import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation._main import EVALUATIONS, run_evaluation
from skylight.evaluation._real_faces import CapturedFaces, aligned_scores
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
    chosen = EVALUATIONS["real-faces"](True, calibrated)
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
