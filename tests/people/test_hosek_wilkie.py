"""Skies of Hosek & Wilkie against Mitsuba's own rendering of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba", reason="mitsuba is not installed")

from skylight.people import _light as light_module
from skylight.people._independent_render import mitsuba_variant
from skylight.people._light import (
    SUN_ELEVATIONS_DEG,
    TURBIDITIES,
    RenderOptions,
    _hosek_wilkie_light,
    hosek_wilkie_sky,
    over_ground,
    scene_light,
)
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import angles_from_direction
from tests.sunny_face import direction

GROUND = torch.tensor([0.2, 0.17, 0.14])
UP = torch.tensor([0.0, 1.0, 0.0])


def sun_at(azimuth_deg: float, elevation_deg: float) -> torch.Tensor:
    return direction(azimuth_deg, 90 - elevation_deg)


def rendered_irradiance(
    turbidity: float, sun: torch.Tensor, normal: np.ndarray, **scale: float
) -> np.ndarray:
    """Of a white plane under Mitsuba's emitter as it is, path traced, in its frame: +Z is up."""
    mi = mitsuba_variant()
    (x, y, z), normal = sun.tolist(), normal[[0, 2, 1]] * [1, -1, 1]
    face = mi.ScalarTransform4f().look_at(
        origin=[0, 0, 0], target=normal.tolist(), up=[0.3, 0.2, 0.9]
    )
    scene = mi.load_dict(
        {
            "type": "scene",
            "light": {
                "type": "sunsky",
                "turbidity": turbidity,
                "albedo": {"type": "rgb", "value": GROUND.tolist()},
                "sun_direction": [x, -z, y],
                **scale,
            },
            "plane": {
                "type": "rectangle",
                "to_world": face,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
            },
        }
    )
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": 5.0,
            "to_world": mi.ScalarTransform4f().look_at(
                origin=(2 * normal).tolist(), target=[0, 0, 0], up=[0.3, 0.2, 0.9]
            ),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "pixel_format": "rgb"},
        }
    )
    path = mi.load_dict({"type": "path", "max_depth": 2, "hide_emitters": True})
    picture = mi.render(scene, sensor=sensor, integrator=path, spp=64, seed=mi.UInt32(3))
    return math.pi * np.array(picture).mean((0, 1))


@pytest.mark.parametrize(("turbidity", "elevation"), [(2.0, 60.0), (4.5, 22.0), (8.0, 7.0)])
def test_sky_and_sun_light_planes_as_mitsuba_has_them(turbidity: float, elevation: float) -> None:
    sun = sun_at(40.0, elevation)
    sky, disc = hosek_wilkie_sky(turbidity, GROUND, sun, 16)
    for normal in (np.array([0.0, 1.0, 0.0]), np.array([0.48, 0.8, -0.36])):
        above = sky.irradiance(torch.from_numpy(normal)).numpy()
        want = rendered_irradiance(turbidity, sun, normal, sun_scale=0.0)
        np.testing.assert_allclose(above, want, rtol=0.02)
        beam = disc.irradiance.numpy() * float(sun @ torch.from_numpy(normal))
        want = rendered_irradiance(turbidity, sun, normal, sky_scale=0.0)
        np.testing.assert_allclose(beam, want, rtol=0.01)


def test_the_map_holds_sun_sky_and_the_ground_that_they_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(light_module, "_FINER", 1)
    sun = sun_at(-75.0, 35.0)
    sky, disc = hosek_wilkie_sky(3.0, GROUND, sun, 32)
    light = over_ground(sky, disc, GROUND)
    whole = light.environment
    assert whole.layout == (64, 128)
    level = whole.upper().irradiance(UP)
    beam = disc.irradiance * sun[1]
    torch.testing.assert_close(level, (sky.irradiance(UP) + beam).float(), rtol=5e-3, atol=0)
    torch.testing.assert_close(whole.radiance[-1, 7], GROUND / math.pi * level, rtol=5e-3, atol=0)
    share = float(luminance(beam.float()) / luminance(level))
    assert 0.6 < share < 0.9  # a clear sky's diffuse part is 10 to 40 % at such a height
    bluer = luminance(beam.float()) / beam[2]
    assert bluer > luminance(level - beam.float()) / (level - beam)[2]


def test_the_sun_is_weaker_and_redder_through_haze_and_by_evening() -> None:
    beams = [
        hosek_wilkie_sky(turbidity, GROUND, sun_at(0, elevation), 8)[1].irradiance
        for turbidity, elevation in ((2.0, 60.0), (8.0, 60.0), (8.0, 8.0))
    ]
    green = [float(beam[1]) for beam in beams]
    redness = [float(beam[0] / beam[2]) for beam in beams]
    assert green[0] > 1.2 * green[1] > 2 * green[2]
    assert redness[0] < redness[1] < redness[2]


def test_scenes_differ_and_are_drawn_from_what_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_module, "_FINER", 1)
    options = RenderOptions(skies="hosek-wilkie", seed=2)
    for scene in range(2):
        lit = scene_light(scene, options)
        assert torch.equal(lit.light.sun.direction, lit.sun)
        off = lit.light.environment.brightest_direction() @ lit.sun
        assert math.degrees(math.acos(min(1.0, float(off)))) < 0.5
    # of many scenes what is drawn, and one sky for all of them
    one = hosek_wilkie_sky(3.0, GROUND, sun_at(0, 45), 8)
    monkeypatch.setattr(light_module, "hosek_wilkie_sky", lambda *_: one)
    lights = [_hosek_wilkie_light(scene, options) for scene in range(16)]
    for lit in lights:
        assert lit.turbidity is not None
        assert TURBIDITIES[0] <= lit.turbidity <= TURBIDITIES[1]
        assert lit.sky_seed is lit.turned_map is None
        assert lit.transmittance == 1
    azimuth, zenith = angles_from_direction(torch.stack([lit.sun for lit in lights]))
    elevation = 90 - torch.rad2deg(zenith)
    assert SUN_ELEVATIONS_DEG[0] <= float(elevation.min()) < 20
    assert 60 < float(elevation.max()) <= SUN_ELEVATIONS_DEG[1]
    assert float(azimuth.min()) < -2
    assert float(azimuth.max()) > 2
    # the ground and the camera are those of the simulated scene of the same number
    other = scene_light(0, replace(options, skies="simulated"))
    assert other.focal == lights[0].focal
    assert torch.equal(other.ground_albedo, lights[0].ground_albedo)
    assert other.turbidity is None
