"""Skies that are known, read as they come, and light models fitted to them."""

import copy
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.evaluation import _sky_models as sky_models
from skylight.evaluation._main import run_evaluation
from skylight.evaluation._sky_models import KnownSkies, SkyModels
from skylight.io._files import write_environment_map
from skylight.models._bundle import load_bundle
from skylight.models._splines import SplineAutoencoder
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angles_from_direction

SHADING = {"mae", "rmse", "si_rmse", "ssim", "mae_aligned", "rmse_aligned", "brightness"}
MAPS = {
    "c.exr": "outdoor-nosun",
    "a.exr": "outdoor-sun",
    "room.exr": "indoor",
    "b.exr": "outdoor-lowsun",
    "street.exr": "night",
}


def a_map(column: int) -> EnvironmentMap:
    """A full map of 1 with a bright pixel 20 rows down."""
    radiance = torch.ones(128, 256, 3)
    radiance[20, column] = 500.0
    return EnvironmentMap(radiance=radiance)


@pytest.fixture
def collection(tmp_path):
    for number, file in enumerate(MAPS):
        write_environment_map(tmp_path / file, a_map(50 * number))
    lines = ["file,category,notes", *(f"{f},{c},some" for f, c in MAPS.items())]
    (tmp_path / "index.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_outdoor_maps_by_day_in_the_order_of_their_names(collection):
    skies = KnownSkies(count=9, seed=0, data=collection)
    assert skies.collected
    assert skies.names() == ["a", "b", "c"]
    assert KnownSkies(count=2, seed=0, data=collection).names() == ["a", "b"]
    read = [skies.sky(i) for i in range(3)]
    assert [s.sun_visible for s in read] == [True, False, False]
    categories = ["outdoor-sun", "outdoor-lowsun", "outdoor-nosun"]
    assert [s.facts["category"] for s in read] == categories
    assert [s.facts["half"] for s in read] == ["development", "held-out", "development"]


def test_the_upper_half_its_sun_ahead_and_its_mean_one(collection):
    skies = KnownSkies(count=9, seed=0, data=collection)
    for number in range(3):
        sky = EnvironmentMap(radiance=skies.sky(number).radiance)
        assert sky.layout == (32, 128)
        azimuth, zenith = angles_from_direction(sky.brightest_direction())
        assert float(azimuth) == pytest.approx(torch.pi / 128, abs=1e-3)
        assert float(zenith) == pytest.approx(20.5 / 128 * torch.pi, abs=0.03)
        mean = luminance(sky.flat).double() @ sky.grid.solid_angles / (2 * torch.pi)
        assert float(mean) == pytest.approx(1, rel=1e-5)


def test_the_share_of_the_sun_survives_the_resizing(collection):
    known = KnownSkies(count=9, seed=0, data=collection).sky(0)
    before, after = a_map(50).upper(), EnvironmentMap(radiance=known.radiance)
    shares = []
    for sky in (before, after):
        value = luminance(sky.flat).double()
        excess = (value - value.median()) @ sky.grid.solid_angles
        shares.append(float(excess / (value @ sky.grid.solid_angles)))
    assert shares[1] == pytest.approx(shares[0], rel=1e-4)


def test_a_collection_without_skies_is_refused(collection):
    (collection / "index.csv").write_text("file,category\nroom.exr,indoor\n")
    with pytest.raises(InputError, match=r"outdoor-sun.*outdoor-nosun"):
        KnownSkies(count=9, seed=0, data=collection / ".." / collection.name)


def test_real_maps_are_the_ones_that_their_index_promises(shared_data):
    skies = KnownSkies(count=999, seed=0, data=shared_data / "hdr")
    visible = [skies.sky(i).facts for i in (0, 1)]
    assert [f["half"] for f in visible] == ["development", "held-out"]
    assert len(skies.names()) > 30


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped model, its skies (but not their suns) three times as bright."""
    shipped = load_bundle()
    network = copy.deepcopy(shipped.network)
    assert isinstance(network, SplineAutoencoder)
    with torch.no_grad():
        network.linear.bias.copy_((network.linear.bias + math.log(3)).half())  # as it is stored
    folder = tmp_path_factory.mktemp("own") / "model"
    replace(shipped, name="own", network=network).save(folder, card="", pictures={})
    return folder


def test_its_autoencoder_is_what_is_scored(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = sky_models.fits
    quick = ("sh9", "autoencoder_feedforward")
    monkeypatch.setattr(sky_models, "fits", lambda light: {k: every(light)[k] for k in quick})
    scores = {}
    for model in (own, None):
        evaluation = SkyModels(count=1, model=model)
        item = evaluation.measure(evaluation.items()[0], tmp_path / "picture.png")
        scores[model] = {method: row["brightness"] for method, row in item.metrics.items()}
    assert scores[own]["sh9"] == scores[None]["sh9"]
    brighter = scores[own]["autoencoder_feedforward"]
    assert brighter > 1.2 * scores[None]["autoencoder_feedforward"]


@pytest.mark.slow
def test_sky_models(tmp_path):
    path = run_evaluation(SkyModels(count=1), tmp_path, command="c")
    rows = json.loads(path.read_text())["rows"]
    assert list(rows) == ["sh9", "sh25", "sunsky", "autoencoder_feedforward", "autoencoder"]
    for row in rows.values():
        assert set(row) >= SHADING | {"full_dw_mae", "sky_dw_mae"}
    assert rows["autoencoder"]["full_dw_mae"]["mean"] < rows["sh9"]["full_dw_mae"]["mean"]
    assert "autoencoder_feedforward mae" in json.loads(path.read_text())["checks"]
