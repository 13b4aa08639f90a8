"""The lights of an estimate beside its map: true directions, irradiance and size."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.estimation._lights import lights_apart
from skylight.inverse._lamps import in_pictures_units
from skylight.inverse._result import MAP_ROWS
from skylight.models._lamps import LampsLight
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between
from tests.inverse.test_sun_prior import about
from tests.sunny_face import direction, sky_estimate, sunny_estimate


def test_lamps_come_apart_and_together():
    model = LampsLight(2)
    params = model.starts_at(
        torch.stack([direction(30.0, 60.0), direction(-60.0, 50.0)])[None].float(),
        torch.tensor([[0.5, 0.2]]),
    )[0, 0]
    whole, lamps = in_pictures_units(model, params, 0.7)
    estimate = replace(sunny_estimate().estimate, environment=whole, lamps=lamps)
    rest, lights = lights_apart(estimate)
    assert whole.layout == (MAP_ROWS, 2 * MAP_ROWS)
    ambient, _ = in_pictures_units(LampsLight(0), params[:16], 0.7)
    assert torch.allclose(rest.radiance, ambient.radiance, rtol=1e-3)
    for light in lights:
        # what the map sends more than its rest on a surface that faces the lamp, the other apart
        facing = whole.irradiance(light.direction) - rest.irradiance(light.direction)
        others = sum(
            other.irradiance * float((other.direction @ light.direction).clamp(min=0))
            for other in lights
            if other is not light
        )
        assert torch.allclose(facing, (light.irradiance + others).float(), rtol=0.03)
        assert light.kind == "lamp"
        assert light.radius_rad > math.radians(5)


def test_a_sun_among_lamps_is_as_wide_as_the_sun_and_sends_as_much():
    model = LampsLight(1)
    towards = direction(30.0, 60.0)[None, None].float()
    params = model.starts_at(towards, torch.tensor([[0.5]]))[0, 0]
    params[..., 16 + 4] = -2.5  # of a spread of 0.7, about 8 degrees
    wide, (lamp,) = in_pictures_units(model, params, 0.7)
    drawn, (sun,) = in_pictures_units(model, params, 0.7, sunny=True)
    assert math.degrees(lamp.spread_rad) == pytest.approx(8 * math.exp(-0.7 * 2.5), rel=1e-4)
    assert torch.equal(sun.irradiance, lamp.irradiance)
    assert float(drawn.radiance.max()) > 4 * float(wide.radiance.max())
    for normal in (sun.direction, direction(-30.0, 80.0), direction(30.0, 140.0)):
        assert torch.allclose(drawn.irradiance(normal), wide.irradiance(normal), rtol=2e-3)
    _, (light,) = lights_apart(replace(sunny_estimate().estimate, environment=drawn, lamps=(sun,)))
    assert (light.kind, math.degrees(light.radius_rad)) == ("sun", pytest.approx(0.2667, rel=1e-3))
    for agrees, clock in ((True, about(30.0, 60.0)), (False, about(-150.0, 26.0))):
        _, (told,) = in_pictures_units(model, params, 0.7, sunny=True, clock=clock)
        assert told.is_sun == agrees
    params[..., 16 + 4] = 0.0
    _, (window,) = in_pictures_units(model, params, 0.7, sunny=True)
    assert not window.is_sun


def test_the_sun_of_a_sky_is_as_wide_as_the_sun():
    estimate = sky_estimate().estimate
    rest, (sun,) = lights_apart(estimate)
    assert sun.kind == "sun"
    assert math.degrees(sun.radius_rad) == pytest.approx(0.2667)
    assert float(angle_between(sun.direction, estimate.sun_direction)) < math.radians(1)
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    together = rest.irradiance(up) + sun.irradiance * float(sun.direction[1])
    assert torch.allclose(together.float(), estimate.environment.irradiance(up), rtol=1e-3)
    told = sun.described()
    assert set(told) == {
        "kind", "direction", "azimuth_deg", "zenith_deg", "irradiance", "angular_radius_deg"
    }  # fmt: skip


def test_even_light_has_none():
    estimate = sunny_estimate().estimate
    even = EnvironmentMap(radiance=torch.ones(MAP_ROWS, 2 * MAP_ROWS, 3))
    assert lights_apart(replace(estimate, environment=even, lamps=()))[1] == []
