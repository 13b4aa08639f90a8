"""Small runs of the evaluations themselves."""

import json

import pytest
import torch

from skylight.evaluation._main import run_evaluation
from skylight.evaluation._real_faces import RealFaces
from skylight.evaluation._sky_models import SkyModels
from skylight.inverse._scores import score
from skylight.models.sunsky import SunSky
from skylight.sphere._envmap import EnvironmentMap

SHADING = {"mae", "rmse", "si_rmse", "ssim", "mae_aligned", "rmse_aligned", "brightness"}


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


@pytest.mark.slow
def test_sky_models(tmp_path):
    path = run_evaluation(SkyModels(count=1), tmp_path, command="c")
    rows = json.loads(path.read_text())["rows"]
    assert list(rows) == ["sh9", "sh25", "sunsky", "autoencoder_feedforward", "autoencoder"]
    for row in rows.values():
        assert set(row) >= SHADING | {"full_dw_mae", "sky_dw_mae"}
    assert rows["autoencoder"]["full_dw_mae"]["mean"] < rows["sh9"]["full_dw_mae"]["mean"]
    assert "autoencoder_feedforward mae" in json.loads(path.read_text())["checks"]


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
    assert results["rows"]["autoencoder"]["finite"]["mean"] == 1
    assert results["rows"]["autoencoder"]["right_side"]["n"] == 1
