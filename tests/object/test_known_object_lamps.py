"""Lamps from known objects: planted lamps come back, as many as there were."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from skylight.errors import InputError
from skylight.object._lamps import COARSE_POINTS, thinned
from skylight.object._problem import ObjectLight, estimate_object_light
from skylight.object._view import ObjectMaterial, ObjectView
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, angle_between
from skylight.transport._cameras import object_camera
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from skylight.transport._render import Specular
from tests.object.test_known_object import CORAL, FRONT, bumpy, lit, part_of, seen_by
from tests.transport.shapes import icosphere

GREY = (0.4, 0.4, 0.4)
RIGHT, LEFT, BELOW = (0.7, 0.5, 0.6), (-0.8, 0.3, 0.5), (0.1, -0.6, 0.8)
# direction, irradiance of a surface that faces it, spread in degrees
Planted = tuple[tuple[float, float, float], tuple[float, float, float], float]
STRONG: Planted = RIGHT, (2.0, 2.0, 2.0), 8.0
WEAK: Planted = LEFT, (1.2, 1.2, 1.2), 8.0
RED: Planted = RIGHT, (2.4, 1.2, 0.6), 8.0
BLUE: Planted = LEFT, (0.5, 1.2, 2.0), 12.0
LOW: Planted = BELOW, (1.0, 1.2, 1.2), 15.0


def unit(direction: tuple[float, float, float]) -> torch.Tensor:
    towards = torch.tensor(direction, dtype=torch.float64)
    return towards / towards.norm()


def planted(*lamps: Planted, ambient: tuple[float, float, float] = GREY) -> EnvironmentMap:
    """von Mises-Fisher lobes in light that is brighter above, on finer rows than estimates'."""
    grid = DirectionGrid.latlong(64)
    radiance = torch.tensor(ambient).double() * (1 + 0.3 * grid.directions[:, 1:2])
    for direction, irradiance, spread_deg in lamps:
        cosine = grid.directions @ unit(direction)
        lobe = torch.exp((cosine - 1) / math.radians(spread_deg) ** 2)
        facing = (lobe * cosine.clamp(min=0)) @ grid.solid_angles
        radiance = radiance + torch.tensor(irradiance).double() * (lobe / facing)[:, None]
    return EnvironmentMap(radiance=radiance.reshape(64, 128, 3).float())


def photographed(view: ObjectView, light: EnvironmentMap) -> Observation:
    """What the view's pixels are by rays towards all of the light's rows; its own transport."""
    fine = TransportMatrix(
        matrix=torch.zeros(1, 1).expand(len(view.observation.pixels), len(light.grid)),
        grid=light.grid,
    )
    seen = replace(view.observation, transport=fine, specular=None)
    pixels = lit(replace(view, observation=seen), light).observation.pixels
    return replace(view.observation, pixels=pixels)


def check(found: ObjectLight, *lamps: Planted) -> None:
    """As many, each within 2 degrees and 10 %, the strongest first."""
    assert len(found.lamps) == len(lamps)
    for lamp, (direction, irradiance, _) in zip(found.lamps, lamps, strict=True):
        assert math.degrees(float(angle_between(lamp.direction, unit(direction)))) < 2
        torch.testing.assert_close(lamp.irradiance, torch.tensor(irradiance), rtol=0.1, atol=0.0)


@cache
def front() -> ObjectView:
    return seen_by(object_camera(FRONT, height=32, width=32), bumpy(), material=CORAL)


@cache
def found_in(*lamps: Planted) -> tuple[Observation, ObjectLight]:
    """The bumpy ball in these lamps and its estimate, made once."""
    seen = photographed(front(), planted(*lamps))
    return seen, estimate_object_light(seen, "lamps", material=CORAL)


def check_light(found: ObjectLight, *lamps: Planted) -> None:
    """The lamps, and what else a result tells where nothing is wrong."""
    light = planted(*lamps)
    check(found, *lamps)
    assert found.light == "lamps"
    assert found.residual < 0.02
    assert found.residual == found.linear_residual
    assert found.clamped_share == 0
    assert found.advice == ()
    assert found.coefficients is found.code is None
    assert found.environment.layout == (64, 128)
    # half a turn from the lamps, where ambient light is all there is
    behind = (light.grid.directions @ unit((0.0, 0.0, -1.0))) > 0.8
    expected, got = (e.flat[behind].mean(0) for e in (light, found.environment))
    torch.testing.assert_close(got, expected, rtol=0.15, atol=0.0)


@pytest.mark.parametrize(
    "lamps",
    [
        (),
        pytest.param((RED,), marks=pytest.mark.slow),
        (RED, BLUE),
        pytest.param((STRONG, WEAK), marks=pytest.mark.slow),
    ],
)
def test_lamps_come_back(lamps: tuple[Planted, ...]) -> None:
    check_light(found_in(*lamps)[1], *lamps)


def test_units_and_an_albedo_that_is_not_known_go_into_the_light() -> None:
    """The prior knows lamps' colours against the ambient light's alone: any tint is as likely."""
    seen, known = found_in(RED)
    folded = estimate_object_light(seen.scaled(7.0), "lamps")
    units = 7 * torch.tensor(CORAL.albedo)
    expected = known.environment.radiance * units
    torch.testing.assert_close(folded.environment.radiance, expected, rtol=1e-2, atol=0.0)
    for lamp, before in zip(folded.lamps, known.lamps, strict=True):
        torch.testing.assert_close(lamp.irradiance, units * before.irradiance, rtol=1e-2, atol=0.0)


def test_a_colour_that_is_black_is_no_light() -> None:
    """Under sodium lamps there is no blue; the other colours are what they were."""
    seen, once = found_in(RED)
    found = estimate_object_light(
        replace(seen, pixels=seen.pixels * torch.tensor([1.0, 1.0, 0.0])), "lamps", material=CORAL
    )
    for lamp, before in zip(found.lamps, once.lamps, strict=True):
        expected = before.irradiance * torch.tensor([1.0, 1.0, 0.0])
        torch.testing.assert_close(lamp.irradiance, expected, rtol=0.05, atol=1e-4)


@pytest.mark.slow
def test_a_metal_shows_three() -> None:
    """A ball without a diffuse part: a mirror that is a little rough."""
    metal = ObjectMaterial(albedo=(0.0, 0.0, 0.0), specular=Specular(f0=0.9, roughness=0.4))
    view = seen_by(object_camera(FRONT, height=56, width=56), icosphere(4), material=metal)
    seen = photographed(view, planted(STRONG, WEAK, LOW))
    check(estimate_object_light(seen, "lamps", material=metal), STRONG, WEAK, LOW)


@pytest.mark.slow
def test_specular_reflection_on_a_coloured_thing() -> None:
    material = ObjectMaterial(albedo=CORAL.albedo, specular=Specular(f0=0.04, roughness=0.4))
    view = seen_by(object_camera(FRONT, height=56, width=56), bumpy(), material=material)
    seen = photographed(view, planted(RED, BLUE))
    check(estimate_object_light(seen, "lamps", material=material), RED, BLUE)


def test_dirt_and_noise_are_no_lamp() -> None:
    """10 % of smooth albedo and 5 % of each pixel; three lamps would explain more of it."""
    seen = photographed(front(), planted(STRONG))
    places = seen.places / seen.places.max()
    dirt = 0.1 * torch.sin(7 * places[:, :1]) * torch.cos(6 * places[:, 1:])
    noise = torch.randn(seen.pixels.shape, generator=torch.Generator().manual_seed(0))
    pixels = seen.pixels * (1 + dirt) * (1 + 0.05 * noise)
    found = estimate_object_light(replace(seen, pixels=pixels), "lamps", material=CORAL)
    (lamp,) = found.lamps
    assert math.degrees(float(angle_between(lamp.direction, unit(RIGHT)))) < 4
    assert found.residual > 0.05


@pytest.mark.slow  # as harmonics do
def test_observations_add_up() -> None:
    """Two halves of the picture, one after the other."""
    whole, once = found_in(RED, BLUE)
    halves = [part_of(whole, half) for half in torch.arange(len(whole.pixels)).chunk(2)]
    found = estimate_object_light(halves, "lamps", material=CORAL)
    check(found, RED, BLUE)
    torch.testing.assert_close(found.rendered, once.rendered, rtol=0.01, atol=1e-3)


def test_a_thinned_observation_is_lit_alike() -> None:
    """Means over its blocks: what a light makes of few points adds up to what it makes of all."""
    seen = photographed(front(), planted(STRONG))
    few = thinned(seen)
    assert len(few.pixels) <= COARSE_POINTS < len(seen.pixels)
    light = planted(WEAK).resize(32).flat
    whole, less = (o.weights @ (o.transport.matrix @ light) for o in (seen, few))
    torch.testing.assert_close(less, whole, rtol=1e-4, atol=0.0)


@pytest.mark.parametrize("value", [0.0, float("nan"), float("inf")])
def test_pixels_without_light_are_refused(value: float) -> None:
    seen = front().observation
    broken = replace(seen, pixels=torch.full_like(seen.pixels, value))
    with pytest.raises(InputError, match="mean luminance of") as caught:
        estimate_object_light(broken, "lamps", material=CORAL)
    assert "\n" not in str(caught.value)
