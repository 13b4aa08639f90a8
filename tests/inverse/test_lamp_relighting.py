"""The light and the shading of an estimate's lamps once they are moved and switched."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.imaging._edits import UNEDITED
from skylight.inverse._descent import Stage
from skylight.inverse._faces import Level
from skylight.inverse._lamp_relighting import FaceTransport, LampLight, lamps_radiance
from skylight.inverse._lamps import MAP_ROWS, LampsOptions, LampsProblem, in_pictures_units
from skylight.inverse._problem import solve
from skylight.inverse._scan import SCAN_HEIGHT
from skylight.models._lamps import LampsLight
from skylight.models._sphere import SphereLight, SpherePrior
from skylight.sphere._envmap import luminance
from skylight.transport._normal_modes import NormalModes
from tests.inverse.test_lamps import lit_ball
from tests.inverse.test_solve import ALBEDO_PRIOR, MODES, ball_normals
from tests.lamp_lit import EXPOSURE, ambient_of, lamp_lit, lamp_params
from tests.sunny_face import sunny_estimate

FEW = LampsOptions(
    coarse=(Stage(level=Level(2), starts=2, iterations=4, even_skin=True, steps="gauss-newton"),),
    fine=(Stage(level=Level(0), starts=1, iterations=2, steps="gauss-newton"),),
)


def known_light() -> LampLight:
    params = lamp_params()
    _, lamps = lamp_lit(params)
    heights = (SCAN_HEIGHT, MAP_ROWS)
    ambient = {rows: LampsLight(0, rows).ambient(params[:16].double()) for rows in heights}
    return LampLight(ambient=ambient, level=EXPOSURE, lamps=lamps)


def test_an_edit_that_changes_nothing_gives_the_map() -> None:
    true, _ = lamp_lit(lamp_params())
    torch.testing.assert_close(
        known_light().environment(MAP_ROWS).radiance, true.radiance, rtol=1e-4, atol=1e-6
    )


def test_without_lamps_there_is_the_ambient_light() -> None:
    light = replace(known_light(), lamps=())
    want = ambient_of(lamp_params())
    torch.testing.assert_close(
        light.environment(MAP_ROWS).radiance.double(), want.radiance, rtol=1e-6, atol=0
    )
    assert float(luminance(light.ambient_irradiance())) == pytest.approx(math.pi * EXPOSURE)
    dark = replace(light, level=0.0)
    assert not bool(dark.radiance(SCAN_HEIGHT).any())


def test_any_place_has_ambient_light_and_lamps_too() -> None:
    """The map of its parameters, from ambient light and lamps apart."""
    params = SpherePrior(2).sample(1, torch.Generator().manual_seed(5))[0]
    latents = SphereLight(0).latents
    params = torch.cat([params[:latents], torch.tensor([0.8]), params[latents:]])
    environment, lamps = in_pictures_units(SphereLight(2), params, EXPOSURE)
    found = replace(sunny_estimate().estimate, light="sphere", environment=environment, lamps=lamps)
    face = replace(found.faces[0], exposure=EXPOSURE)
    light = LampLight.of(replace(found, params=params, faces=(face,)))
    torch.testing.assert_close(
        light.environment(MAP_ROWS).radiance, environment.radiance, rtol=1e-3, atol=1e-5
    )
    on_faces = SphereLight(2)(params.double())
    torch.testing.assert_close(
        light.radiance(SCAN_HEIGHT).double(), EXPOSURE * on_faces, rtol=1e-3, atol=1e-5
    )


@pytest.mark.parametrize("to", [(0.0, 1.0, 0.0), (0.0, -0.2, 1.0), (-0.7, -0.7, 0.1)])
def test_a_moved_lamp_keeps_its_irradiance(to: tuple[float, float, float]) -> None:
    """What a surface that faces it receives, by quadrature over the map of it alone."""
    lamp = known_light().lamps[0]
    direction = torch.nn.functional.normalize(torch.tensor(to, dtype=torch.float64), dim=0)
    radiance = lamps_radiance([replace(lamp, direction=direction)], 128)
    grid = LampsLight(0, 128).grid
    cosines = (grid.directions.double() @ direction).clamp(min=0)
    received = (cosines * grid.solid_angles.double()) @ radiance
    torch.testing.assert_close(received, lamp.irradiance.double(), rtol=2e-3, atol=0)


@pytest.mark.parametrize("grey", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_an_edit_that_changes_nothing_gives_the_face(grey: bool) -> None:
    """Of a ball of uncertain normals, and another exposure than the map's."""
    seen = lit_ball(((0.7, 0.4, 0.6), 3.0))
    normals = torch.as_tensor(ball_normals()[1])
    turn = torch.stack([normals.roll(1, 1), normals.roll(2, 1)], 2).float() / 20
    modes = NormalModes.of(seen.transport, normals.double(), turn, SCAN_HEIGHT)
    seen = replace(seen, normal_modes=modes, grey=grey)
    if grey:
        seen = replace(seen, pixels=luminance(seen.pixels)[:, None].expand(-1, 3))
    brighter = replace(seen, pixels=3 * seen.pixels)
    problem = LampsProblem(ALBEDO_PRIOR, MODES, FEW)
    for photo, one in enumerate((seen, brighter)):
        problem.add(one, photo)
    (found,) = solve([problem])
    assert found.lamps
    light = LampLight.of(found)
    torch.testing.assert_close(
        light.environment(MAP_ROWS).radiance, found.environment.radiance, rtol=1e-4, atol=1e-6
    )
    for observation, face in zip((seen, brighter), found.faces, strict=True):
        assert bool(face.turns.any())
        transport = FaceTransport.of(observation, face, found.exposure)
        rendered = transport.rendered(light)
        torch.testing.assert_close(
            rendered, face.rendered, rtol=1e-4, atol=1e-4 * float(face.rendered.mean())
        )
        transport = replace(transport, edit=UNEDITED)
        rendered = transport.rendered(light)
        # shading is linear in light: lamps one by one, and ambient light, add up where none clamps
        parts = [replace(light, level=0.0, lamps=(lamp,)) for lamp in light.lamps]
        parts.append(replace(light, lamps=()))
        added = torch.stack([transport.rendered(part) for part in parts]).sum(0)
        unclamped = (transport.diffuse @ light.radiance(SCAN_HEIGHT) > 0).all(1)
        for part in parts:
            unclamped &= (transport.diffuse @ part.radiance(SCAN_HEIGHT) >= 0).all(1)
        assert bool(unclamped.any())
        torch.testing.assert_close(added[unclamped], rendered[unclamped], rtol=1e-4, atol=1e-5)
