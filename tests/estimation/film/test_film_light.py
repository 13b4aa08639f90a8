"""One drifting sky over a film of half balls, whose light and cameras are known."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from skylight.estimation.film._light import FilmLight, FilmProblem, in_world
from skylight.faces._skin import SkinPrior
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import light_problems
from skylight.inverse._faces import Level
from skylight.inverse._lamps import LampsProblem
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.models._bundle import load_bundle
from skylight.models._ground import LambertianGround
from skylight.models.sunsky import SunSky
from skylight.sphere._frame import DirectionGrid, angles_from_direction
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation

SKIN = SkinPrior.load()
QUICK = SolverOptions(
    stages=(
        Stage(level=Level(1), starts=3, iterations=15),
        Stage(level=Level(1), starts=2, iterations=8),
        Stage(level=Level(0), starts=1, iterations=5),
    )
)
SKY = SunSky()


def problem() -> SkyProblem:
    return SkyProblem(
        SKY,
        copy.deepcopy(load_bundle().sunsky_prior),
        copy.deepcopy(SKIN.log_albedo).float(),
        SKIN.means.float(),
        QUICK,
    )


def half_ball(turn: np.ndarray, sun_azimuth: float, exposure: float) -> Observation:
    """Half a ball before a camera that is turned so, in the world's sun, with 1 % of noise."""
    line = (torch.arange(8) + 0.5) / 8 * 2 - 1
    y, x = torch.meshgrid(-line, line, indexing="ij")
    inside = x**2 + y**2 < 0.9
    x, y = x[inside], y[inside]
    normals = torch.stack([x, y, (1 - x**2 - y**2).sqrt()], 1).double()
    grid = DirectionGrid.latlong(64)
    cosine = (normals @ grid.directions.T).clamp(min=0)
    transport = (cosine * grid.solid_angles / math.pi).float()
    # what the ball shades exactly: its normals in the world, under the world's light
    colours = [0.45, 0.55, 0.8, 5.5, 5.0, 4.2]
    light = torch.tensor([[*colours, sun_azimuth, 0.8, 3.5, 700.0]])
    sky = SKY(light)
    full = LambertianGround(32).append(sky, torch.tensor([[0.15, 0.13, 0.11]]))[0]
    in_the_world = normals @ torch.from_numpy(turn.T.copy())
    shading = (in_the_world @ grid.directions.T).clamp(min=0) * grid.solid_angles / math.pi
    albedo = SKIN.means[1].float()
    pixels = exposure * albedo * (shading.float() @ full)
    noise = torch.Generator().manual_seed(round(1e4 * sun_azimuth) + round(1e3 * exposure))
    pixels = pixels * (1 + 0.01 * torch.randn(pixels.shape, generator=noise))
    return Observation(
        pixels=pixels,
        weights=torch.ones(len(pixels)),
        places=torch.nonzero(inside),
        transport=TransportMatrix(matrix=transport, grid=grid),
    )


def film(azimuths: list[float], step_s: float = 0.5) -> FilmLight:
    one = FilmProblem(problem())
    for k, azimuth in enumerate(azimuths):
        angles = [25 * math.sin(k), 5 * math.cos(2 * k), 0]
        turn = Rotation.from_euler("yxz", angles, degrees=True).as_matrix()
        seen = half_ball(turn, azimuth, 0.3 * 1.1 ** (k % 3))
        one.add(in_world(seen, turn), step_s * k)
    return one.solve()


def azimuths_of(light: FilmLight) -> np.ndarray:
    return np.array([float(angles_from_direction(f.sun_direction)[0]) for f in light.frames])


@pytest.fixture(scope="module")
def still() -> FilmLight:
    return film([2.3] * 5)


class TestASunThatStands:
    def test_it_is_found_in_the_world_whatever_the_camera_does(self, still: FilmLight) -> None:
        assert np.abs(azimuths_of(still) - 2.3).max() < math.radians(3)
        azimuth, zenith = angles_from_direction(still.mean.sun_direction)
        assert float(azimuth) == pytest.approx(2.3, abs=math.radians(2))
        assert float(zenith) == pytest.approx(0.8, abs=math.radians(4))

    def test_it_stands(self, still: FilmLight) -> None:
        found = azimuths_of(still)
        assert np.abs(found - found.mean()).max() < math.radians(0.7)
        assert still.drift_per_s < 5e-4

    def test_exposures_are_each_frames_own(self, still: FilmLight) -> None:
        exposures = np.array([frame.exposure for frame in still.frames])
        np.testing.assert_allclose(exposures / exposures[0], 1.1 ** (np.arange(5) % 3), rtol=0.03)

    def test_every_frame_is_explained(self, still: FilmLight) -> None:
        assert max(frame.residual for frame in still.frames) < 0.03


def test_a_sun_that_moves_is_followed() -> None:
    """By 15 degrees an hour, through an hour."""
    truth = 2.1 + np.radians(3) * np.arange(5)
    moving = film(truth.tolist(), 720.0)
    found = azimuths_of(moving)
    assert np.abs(found - truth).max() < math.radians(5)  # smoothed most at the ends
    assert found[-1] - found[0] > 0.3 * (truth[-1] - truth[0])  # drawn together, not held
    assert moving.drift_per_s > 1e-6


def test_one_keyframe_is_enough() -> None:
    light = film([2.3])
    assert len(light.frames) == 1
    assert azimuths_of(light)[0] == pytest.approx(2.3, abs=math.radians(4))


@pytest.mark.slow
def test_light_of_any_place_keeps_its_lamps_over_a_film() -> None:
    """A sun in an even sky, by the model of any place: as many lamps in every keyframe."""
    (empty,) = light_problems("sphere", device="cpu")
    assert isinstance(empty, LampsProblem)
    quick = replace(
        empty.options,
        scan_candidates=3,
        sets=3,
        coarse=(replace(empty.options.coarse[1], starts=3),),
        fine=empty.options.fine[1:],
    )
    empty.options = quick
    one = FilmProblem(empty)
    for k in range(3):
        turn = Rotation.from_euler("y", 20 * k, degrees=True).as_matrix()
        one.add(in_world(half_ball(turn, 2.3, 0.3), turn), 0.5 * k)
    light = one.solve()
    count = len(light.start.lamps)
    assert {len(frame.lamps) for frame in (*light.frames, light.mean)} == {count}
    assert np.abs(azimuths_of(light) - 2.3).max() < math.radians(6)
    assert max(frame.residual for frame in light.frames) < 0.05
    assert light.ground_albedo.shape == (3,)
    assert light.mean.environment.layout == (256, 512)
