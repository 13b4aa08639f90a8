"""What an estimate is told of the truth: where the true sky lies in the model, and the albedo."""

import math

import pytest
import torch

from skylight.evaluation._known_faces import FIRST_SEED, KnownFace, rendered_here
from skylight.evaluation._synthetic_faces import OneStart, true_parameters, with_true_albedo
from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.inverse._estimate import smooth_autoencoder
from skylight.models._bundle import load_bundle
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between
from skylight.transport._observation import Observation


@pytest.fixture(scope="module")
def face() -> KnownFace:
    return rendered_here(FIRST_SEED, 128)


@pytest.fixture(scope="module")
def observation(face: KnownFace) -> Observation:
    model = HeadModel.load()
    return observe_face(
        face.picture, face.clipped, model, face.truth, face_height_px=30
    ).observation


def test_true_parameters_put_the_sun_where_it_is(face: KnownFace) -> None:
    parameters = true_parameters(face.environment, held=20, released=20)
    sky = load_bundle().light()(parameters)[0].detach()
    layout = load_bundle().light().grid.layout
    assert layout is not None
    found = EnvironmentMap(radiance=sky.reshape(*layout, 3)).brightest_direction()
    away = angle_between(found.double(), face.environment.brightest_direction().double())
    assert math.degrees(float(away)) < 4


@pytest.mark.slow
def test_a_known_albedo_is_kept(face: KnownFace, observation: Observation) -> None:
    found = with_true_albedo(observation, face)
    assert float((found.faces[0].albedo / face.albedo).log().abs().max()) < 0.05


def test_one_start_looks_nowhere_else() -> None:
    shipped = smooth_autoencoder(load_bundle())
    parameters = shipped.starts()[:1]
    model = OneStart(parameters)
    towards = model.starts_towards(torch.eye(3)).flatten(0, 1)
    assert torch.equal(towards, parameters.expand(3, -1))
    assert torch.equal(model.starts(), parameters)
    assert torch.equal(model.on_rows(16).starts(), parameters)
    assert model.on_rows(16).grid.layout == (16, 64)
    free = model.to_free(parameters)
    torch.testing.assert_close(model.from_free(free), parameters)
    assert torch.equal(model(parameters), shipped(parameters))
