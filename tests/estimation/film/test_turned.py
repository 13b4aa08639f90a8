"""Observations of turned cameras against light that is turned instead."""

import math

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from skylight.estimation.film._light import in_world
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._normal_modes import NormalModes
from skylight.transport._observation import Observation

ROWS = 32


def seen() -> Observation:
    """Forty points that face anywhere, in the camera's frame."""
    rng = torch.Generator().manual_seed(0)
    normals = torch.nn.functional.normalize(torch.randn(40, 3, generator=rng).double(), dim=1)
    grid = DirectionGrid.latlong(ROWS)
    cosine = (normals @ grid.directions.T).clamp(min=0)
    transport = TransportMatrix(matrix=(cosine * grid.solid_angles / math.pi).float(), grid=grid)
    modes = 0.1 * torch.randn(40, 3, 2, generator=rng)
    return Observation(
        pixels=torch.ones(40, 3),
        weights=torch.ones(40),
        places=torch.arange(80).reshape(40, 2),
        transport=transport,
        specular=transport,
        normal_modes=NormalModes.of(transport, normals, modes, 16),
    )


def light() -> EnvironmentMap:
    """Smooth, and different everywhere."""
    directions = DirectionGrid.latlong(ROWS).directions
    axes = torch.tensor([[0.3, 0.8, -0.5], [-0.6, 0.5, 0.6], [0.9, -0.1, 0.4]]).double()
    lobes = torch.exp(4 * (directions @ torch.nn.functional.normalize(axes, dim=1).T - 1))
    return EnvironmentMap(radiance=lobes.float().reshape(ROWS, 2 * ROWS, 3))


def test_light_that_is_the_same_everywhere_stays() -> None:
    observation = seen()
    turn = Rotation.from_euler("yxz", [31, -17, 8], degrees=True).as_matrix()
    turned = in_world(observation, turn)
    torch.testing.assert_close(
        turned.transport.matrix.sum(1), observation.transport.matrix.sum(1), rtol=1e-5, atol=1e-6
    )


def test_a_turn_about_the_vertical_by_whole_columns_is_exact() -> None:
    observation, world = seen(), light()
    columns = 5
    # about +Y a positive angle lowers the azimuth: the camera looks to its left
    turn = Rotation.from_euler("y", columns * 180 / ROWS, degrees=True).as_matrix()
    in_camera = EnvironmentMap(radiance=world.radiance.roll(columns, dims=1))
    expected = observation.transport.matrix @ in_camera.flat
    found = in_world(observation, turn)
    torch.testing.assert_close(found.transport.matrix @ world.flat, expected, rtol=1e-4, atol=1e-5)
    assert found.specular is not None
    torch.testing.assert_close(found.specular.matrix @ world.flat, expected, rtol=1e-4, atol=1e-5)


def test_any_turn_is_that_of_the_light() -> None:
    observation, world = seen(), light()
    turn = Rotation.from_euler("yxz", [40, 20, -10], degrees=True).as_matrix()
    in_camera = world.rotate(torch.from_numpy(turn.T.copy()))
    expected = observation.transport.matrix @ in_camera.flat
    found = in_world(observation, turn).transport.matrix @ world.flat
    assert float((found - expected).abs().max() / expected.mean()) < 0.02


def test_what_wrong_normals_do_turns_too() -> None:
    """<M u, F> of every point: a scalar that does not depend on the frame."""
    observation, world = seen(), light()
    turn = Rotation.from_euler("yxz", [-25, 10, 5], degrees=True).as_matrix()
    in_camera = world.rotate(torch.from_numpy(turn.T.copy()))

    def added(one: Observation, environment: EnvironmentMap) -> np.ndarray:
        modes = one.normal_modes
        assert modes is not None
        radiance = environment.resize(16).flat
        grid = modes.grid.directions.float()
        vector = torch.einsum("mn,nd,nc->mdc", modes.visible, grid, radiance)
        return torch.einsum("mdk,mdc->mkc", modes.modes, vector).numpy()

    expected = added(observation, in_camera)
    found = added(in_world(observation, turn), world)
    assert np.abs(found - expected).max() < 0.05 * np.abs(expected).max()
