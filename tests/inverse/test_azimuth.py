"""How far a probe is turned, by shading whose light is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import nnls

from skylight.errors import InputError
from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.inverse._azimuth import azimuth_curve, local_minima, relit_face
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation

HEIGHT, WIDTH = 8, 16
ALBEDO, SPECULAR_SCALE = torch.tensor([0.6, 0.4, 0.3]), 1.3


def random(*shape: int, seed: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def probe() -> EnvironmentMap:
    return EnvironmentMap(radiance=random(HEIGHT, WIDTH, 3, seed=1) ** 4)


@pytest.fixture(scope="module")
def observation(probe) -> Observation:
    """60 points turned every way towards the camera, in the probe turned by 5 columns."""
    grid = DirectionGrid.latlong(HEIGHT)
    normals = torch.nn.functional.normalize(random(60, 3, seed=2).double() - 0.5, dim=1)
    normals[:, 2] = normals[:, 2].abs()
    cosines = (normals @ grid.directions.T).clamp(min=0)
    diffuse = (cosines * grid.solid_angles / math.pi).float()
    shine = (cosines**20 * grid.solid_angles).float()
    light = probe.radiance.roll(5, dims=1).reshape(-1, 3)
    return Observation(
        pixels=ALBEDO * (diffuse @ light) + SPECULAR_SCALE * (shine @ light),
        weights=random(60, seed=3),
        places=torch.stack([torch.arange(60), torch.zeros(60, dtype=torch.long)], 1),
        transport=TransportMatrix(matrix=diffuse, grid=grid),
        specular=TransportMatrix(matrix=shine, grid=grid),
    )


def test_the_true_turn_has_no_error(observation, probe):
    curve = azimuth_curve(observation, probe)
    best = curve.minima[0]
    assert float(curve.azimuth_deg[best]) == pytest.approx(5 * 360 / WIDTH)
    assert float(curve.error[best]) == pytest.approx(0, abs=1e-5)
    assert float(curve.error.median()) > 0.05


def test_turning_the_probe_shifts_the_curve(observation, probe):
    curve = azimuth_curve(observation, probe)
    for columns in (1, 7):
        turned = EnvironmentMap(radiance=probe.radiance.roll(columns, dims=1))
        shifted = azimuth_curve(observation, turned)
        torch.testing.assert_close(shifted.error, curve.error.roll(-columns), atol=1e-5, rtol=1e-5)


def test_exposure_and_white_balance_change_nothing(observation, probe):
    error = azimuth_curve(observation, probe).error
    brighter = azimuth_curve(observation.scaled(37.0), probe).error
    torch.testing.assert_close(brighter, error, atol=1e-5, rtol=1e-5)
    # without specular reflection, whose strength all channels share, each channel has a scale of
    # its own
    diffuse = replace(observation, specular=None)
    tinted = EnvironmentMap(radiance=probe.radiance * torch.tensor([2.0, 1.0, 0.25]))
    torch.testing.assert_close(
        azimuth_curve(diffuse, tinted).error,
        azimuth_curve(diffuse, probe).error,
        atol=1e-5,
        rtol=1e-5,
    )


def test_every_error_is_the_least_possible(observation, probe):
    """Against a solver of non-negative least squares, light after light, in float64."""
    seen = observation.pixels.double().numpy() * np.array([1.0, 0.7, 1.4])  # no exact answer
    weight = observation.weights.double().numpy()
    weight = weight / weight.sum()
    disturbed = replace(observation, pixels=torch.from_numpy(seen).float())
    curve = azimuth_curve(disturbed, probe)
    for place, degrees in enumerate(curve.azimuth_deg.tolist()):
        turned = np.roll(probe.radiance.double().numpy(), round(degrees / 360 * WIDTH), 1)
        light = turned.reshape(-1, 3)
        diffuse = observation.transport.matrix.double().numpy() @ light
        shine = observation.specular.matrix.double().numpy() @ light
        system = np.zeros((60, 3, 4))
        system[:, range(3), range(3)] = diffuse
        system[:, :, 3] = shine
        root = np.sqrt(weight)[:, None]
        _, rest = nnls((system * root[..., None]).reshape(-1, 4), (seen * root).reshape(-1))
        expected = rest / math.sqrt(3) / (weight @ seen).mean()
        assert float(curve.error[place]) == pytest.approx(expected, rel=1e-4)


def test_over_exposed_pixels_say_nothing(observation, probe):
    clipped = torch.arange(60) % 4 == 0
    cut = torch.where(clipped[:, None], 0.3 * observation.pixels, observation.pixels)
    over = replace(observation, pixels=cut, clipped=clipped)
    curve = azimuth_curve(over, probe)
    rest = replace(observation, weights=observation.weights * ~clipped)
    torch.testing.assert_close(curve.error, azimuth_curve(rest, probe).error)
    blind = azimuth_curve(replace(over, clipped=None), probe)
    assert float(curve.error.min()) < 1e-4 < 0.05 < float(blind.error.min())


def test_the_relit_face_is_the_one_measured(observation, probe):
    matched = relit_face(observation, probe, 5 * 360 / WIDTH)
    torch.testing.assert_close(matched, observation.pixels, atol=1e-4, rtol=1e-4)


def test_a_finer_probe_is_brought_to_the_grid(observation, probe):
    fine = probe.radiance.repeat_interleave(2, 0).repeat_interleave(2, 1)
    curve = azimuth_curve(observation, EnvironmentMap(radiance=fine))
    assert len(curve.error) == WIDTH
    assert float(curve.azimuth_deg[curve.minima[0]]) == pytest.approx(5 * 360 / WIDTH)


def test_minima_of_a_made_curve():
    turn = torch.arange(64) * (2 * math.pi / 64)
    # dips at 0 (the deepest, across the ends), 21 and 43; ripples that are none
    curve = 1 - torch.cos(3 * turn) - 0.5 * torch.cos(turn - 0.05) + 1e-4 * torch.cos(31 * turn)
    found = local_minima(curve.double(), prominence=0.05)
    assert found[0] in (0, 1, 63)
    assert sorted(found[1:]) == pytest.approx([21, 43], abs=2)
    # closed: turning the curve turns its minima
    turned = local_minima(curve.double().roll(5), prominence=0.05)
    assert [(i - 5) % 64 for i in turned] == list(found)


def test_of_a_flat_bottom_the_middle_counts():
    curve = torch.ones(16)
    curve[4:7] = 0.0
    assert local_minima(curve.double(), prominence=0.1) == (5,)


def test_light_without_a_direction_has_no_azimuth(observation):
    rows = torch.linspace(1, 2, HEIGHT)[:, None, None]
    level = EnvironmentMap(radiance=rows.expand(-1, WIDTH, 3))
    with pytest.raises(InputError, match="the same light from all sides"):
        azimuth_curve(observation, level)


def test_light_that_reaches_no_point(observation, probe):
    dark = replace(observation.transport, matrix=torch.zeros_like(observation.transport.matrix))
    with pytest.raises(InputError, match="no light on the face"):
        azimuth_curve(replace(observation, transport=dark, specular=None), probe)


def test_a_rendered_face_in_its_true_geometry(face_captures):
    face = face_captures.face
    view = observe_face(face.picture, face.clipped, HeadModel.load(), face.truth, face_height_px=40)
    turn = 31 * 2.8125
    probe = face.environment.rotate_azimuth(-math.radians(turn))
    curve = azimuth_curve(view.observation, probe)
    assert float(curve.azimuth_deg[curve.minima[0]]) == pytest.approx(turn, abs=3)
