"""Evaluations of skies with a trained model of one's own."""

import copy
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from skylight.evaluation import _main as main, _sky_models as sky_models
from skylight.evaluation._known_faces import EstimateOptions
from skylight.evaluation._run import Evaluation
from skylight.evaluation._sky_models import SkyModels
from skylight.models._bundle import load_bundle
from skylight.models._splines import SplineAutoencoder


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


@pytest.mark.parametrize("name", ["sky-models", "sky-representations"])
def test_the_command_hands_the_model_on(
    name: str, own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Evaluation] = []

    def run(evaluation: Evaluation, out: Path, **_: object) -> Path:
        given.append(evaluation)
        return out

    monkeypatch.setattr(main, "run_evaluation", run)
    for model in (own, None):
        options = None if model is None else EstimateOptions(model=model)
        main.evaluate(name, quick=True, data=None, out=tmp_path, options=options)
    with_own, shipped = (one.config() for one in given)
    assert with_own == {**shipped, "model": load_bundle(own).fingerprint}


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
