"""The thesis' solver (B.1): one start, from the mean sky turned to the light, on four levels."""

import math
from dataclasses import replace

import pytest
import torch

from skylight._names import SOLVER_NAMES, check_solver_name
from skylight.errors import InputError
from skylight.inverse._estimate import estimate_light, light_problems, smooth_autoencoder
from skylight.inverse._sky import SOLVERS, THESIS, SkyProblem, linear_direction
from skylight.models._bundle import load_bundle
from skylight.models._network import COARSE_HEIGHTS
from skylight.models.autoencoder import AutoencoderLight
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, angles_from_direction
from tests.inverse.test_solve import SUNS, ball_normals, observed, watched


def test_the_linear_direction_of_light_of_degree_2_is_its_moment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Half a ball has the normals for all nine harmonics."""
    monkeypatch.setattr("skylight.inverse._sky._RIDGE", 1e-9)
    _, normals = ball_normals()
    grid = DirectionGrid.latlong(64)
    coefficients = torch.tensor([4.0, -0.5, 0.8, 1.1, 0.3, 0.0, -0.2, 0.1, 0.2]).double()
    light = harmonics.evaluate(grid.directions, 2) @ coefficients
    cosine = (torch.from_numpy(normals) @ grid.directions.T).clamp(min=0)
    shading = cosine @ (light * grid.solid_angles)
    seen = observed(shading[:, None].expand(-1, 3).numpy())
    moment = (light * grid.solid_angles) @ grid.directions
    off = torch.dot(linear_direction([seen]), moment / moment.norm())
    assert math.degrees(math.acos(min(1.0, float(off)))) < 0.5


@pytest.mark.parametrize("sun", SUNS)
def test_the_linear_direction_is_near_a_sun_s_azimuth(sun: tuple[float, float]) -> None:
    seen, _ = watched(*sun)
    azimuth, _ = angles_from_direction(linear_direction([seen]))
    assert math.degrees(float(azimuth)) == pytest.approx(sun[0], abs=12)


def test_several_faces_and_what_is_clipped_count() -> None:
    one, other = watched(140.0, 40.0)[0], watched(-110.0, 60.0)[0]
    both = linear_direction([one]) + linear_direction([other])
    torch.testing.assert_close(linear_direction([one, other]), both / both.norm())
    bright = luminance(one.pixels) > luminance(one.pixels).quantile(0.9)
    spoilt = replace(one, pixels=torch.where(bright[:, None], 50.0, one.pixels), clipped=bright)
    without = replace(one, weights=one.weights * ~bright)
    torch.testing.assert_close(linear_direction([spoilt]), linear_direction([without]))


def test_each_level_halves_the_picture_and_the_light() -> None:
    """B.1: four levels for face and light, one start, L-BFGS on each."""
    assert THESIS.start == "mean"
    assert [(s.level.pixels, s.level.light) for s in THESIS.stages] == [
        (k, k) for k in (3, 2, 1, 0)
    ]
    assert {(stage.starts, stage.iterations) for stage in THESIS.stages} == {(1, 100)}
    seen, _ = watched(140.0, 40.0)
    (problem,) = light_problems("autoencoder", options=THESIS)
    problem.add(seen)
    (face,) = problem.faces
    columns = [face.pyramid[s.level].transport.folded.shape[-1] - 1 for s in THESIS.stages]
    assert [columns[-1] // c for c in columns] == [64, 16, 4, 1]


def test_it_has_one_start_towards_the_light() -> None:
    seen, _ = watched(140.0, 40.0)
    (problem,) = light_problems("autoencoder", options=THESIS)
    assert isinstance(problem, SkyProblem)
    problem.add(seen)
    points = problem.solver.starts(problem.faces, None, torch.eye(3))
    assert points.free.shape[0] == 1
    light = points.free[0, : problem.solver.model.parameter_count]
    assert float(light[:-1].abs().max()) < 1e-4  # whitened: the mean of all latents
    assert float(light[-1]) == pytest.approx(math.radians(140), abs=math.radians(12))


@pytest.mark.slow
def test_it_finds_a_sun_that_the_mean_sky_leads_to() -> None:
    seen, world = watched(140.0, 40.0)
    found = estimate_light(seen, "autoencoder", options=THESIS)
    sun = torch.as_tensor(world.sun).double()
    assert math.degrees(math.acos(float(found.sun_direction.double() @ sun))) < 20
    assert found.status == "converged"


def test_names_are_checked() -> None:
    assert set(SOLVERS) == set(SOLVER_NAMES)
    assert check_solver_name("thesis", "autoencoder") == "thesis"
    with pytest.raises(InputError, match="thesis is for the light autoencoder, not for sunsky"):
        check_solver_name("thesis", "sunsky")
    with pytest.raises(InputError, match="choose one of scan, thesis"):
        check_solver_name("newton", "autoencoder")


@pytest.mark.parametrize("rows", COARSE_HEIGHTS)
def test_coarse_skies_hold_the_same_light(rows: int) -> None:
    """Irradiance of planes that face the sky, from three sides."""
    model = smooth_autoencoder(load_bundle())
    params = model.bank[:4]
    params = torch.cat([params, torch.tensor([[0.0], [1.0], [2.0], [3.0]])], 1)
    normals = torch.tensor([[0.0, 1.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.6, -0.8]]).double()

    def irradiance(one: AutoencoderLight) -> torch.Tensor:
        cosine = (one.grid.directions @ normals.T).clamp(min=0) * one.grid.solid_angles[:, None]
        return torch.einsum("nk,bnc->bkc", cosine, one(params).double())

    fine, coarse = irradiance(model), irradiance(model.on_rows(rows))
    torch.testing.assert_close(coarse, fine, rtol=0.1, atol=0.02 * float(fine.mean()))
