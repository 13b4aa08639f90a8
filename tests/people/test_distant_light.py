"""The sun is a disc: its irradiance, its place in the map, its penumbra."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad

pytest.importorskip("mitsuba", reason="mitsuba is not installed")

from skylight.people._independent_render import mitsuba_variant, pinhole
from skylight.people._light import (
    FAINT_SUN,
    DistantLight,
    RenderOptions,
    SunDisc,
    camera_frame,
    scene_light,
)
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angle_between, rotation_about
from skylight.transport._cameras import Camera
from tests.sunny_face import direction

IRRADIANCE = torch.tensor([3.0, 2.0, 1.0])


def towards(azimuth_deg: float, elevation_deg: float) -> torch.Tensor:
    return direction(azimuth_deg, 90 - elevation_deg)


def dark(height: int = 64) -> EnvironmentMap:
    return EnvironmentMap(radiance=torch.zeros(height, 2 * height, 3))


@pytest.mark.parametrize(("azimuth", "elevation"), [(12.3, 4.0), (-170.0, 33.0), (179.5, 71.7)])
def test_the_map_holds_the_suns_irradiance_where_it_stands(
    azimuth: float, elevation: float
) -> None:
    sun = SunDisc(direction=towards(azimuth, elevation), irradiance=IRRADIANCE)
    whole = DistantLight(dark(), sun).environment
    torch.testing.assert_close(whole.integrate(), IRRADIANCE)
    off = angle_between(whole.mean_direction(), sun.direction)
    assert math.degrees(float(off)) < 0.1
    assert math.degrees(float(angle_between(whole.brightest_direction(), sun.direction))) < 0.1
    # a plane that the sun grazes: 4 pixels' centres stand for it
    torch.testing.assert_close(whole.irradiance(sun.direction), IRRADIANCE, rtol=1e-3, atol=0)
    assert not whole.radiance[32:].any()


def test_a_sun_on_the_horizon_does_not_light_the_ground() -> None:
    sun = SunDisc(direction=towards(0.0, 0.3), irradiance=IRRADIANCE)
    whole = DistantLight(dark(), sun).environment
    torch.testing.assert_close(whole.integrate(), IRRADIANCE)
    assert not whole.radiance[32:].any()
    assert DistantLight(dark()).environment.radiance.sum() == 0


def test_the_disc_in_a_picture_has_its_irradiance() -> None:
    """Summed over pixels' solid angles, limb and all."""
    camera = Camera(focal_px=3000.0, width=64, height=64, center_px=(32.0, 32.0))
    sun = SunDisc(direction=towards(0.1, -0.05), irradiance=IRRADIANCE)
    seen = sun.in_pixels(camera.rays(), 1 / camera.focal_px)
    torch.testing.assert_close(
        (seen.sum(0) / camera.focal_px**2).float(), IRRADIANCE, rtol=0.01, atol=0
    )


def test_a_turned_camera_sees_the_sun_turned() -> None:
    turn = rotation_about(torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), 0.5).numpy()
    sun = towards(20.0, 30.0)
    np.testing.assert_allclose(camera_frame(sun, None), sun)
    np.testing.assert_allclose(turn @ camera_frame(sun, turn), sun)


def lit_plane(sun: SunDisc, occluder: dict[str, object], samples: int) -> np.ndarray:
    """Irradiance of a white plane at z = 0, 4 cm wide, under something above it; (64,3) over x."""
    mi = mitsuba_variant()
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sun": sun.emitter(mi, np.zeros(3), sun.direction.numpy()),
            "plane": {"type": "rectangle", "bsdf": white},
            "occluder": occluder,
        }
    )
    camera = Camera(focal_px=800.0, width=64, height=64, center_px=(32.0, 32.0))
    film = {"pixel_format": "rgb"}
    place = np.array([0.0, 0.0, -0.5])
    sensor = mi.load_dict(pinhole(camera, np.eye(3), place, samples=samples, film=film))
    path = mi.load_dict({"type": "path", "max_depth": 2})
    picture = np.array(mi.render(scene, sensor=sensor, integrator=path, seed=mi.UInt32(1)))
    return math.pi * picture.mean(0)


def test_the_penumbra_is_that_of_a_disc() -> None:
    """Behind an edge h above a plane: (acos u - u sqrt(1 - u^2)) / pi, u = x / (h tan a)."""
    mi = mitsuba_variant()
    above = 0.8  # m, so that the penumbra is 7.4 mm wide; the camera is below it
    half = mi.ScalarTransform4f().translate([0.5, 0, above]).scale([0.5, 1.0, 1.0])
    black = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
    occluder: dict[str, object] = {"type": "rectangle", "to_world": half, "bsdf": black}
    sun = SunDisc(direction=torch.tensor([0.0, 0.0, 1.0]).double(), irradiance=IRRADIANCE)
    got = lit_plane(sun, occluder, 256)
    x = (np.arange(64) + 0.5 - 32) / 800 * 0.5
    u = (x / (above * math.tan(SUN_RADIUS_RAD))).clip(-1, 1)
    want = (np.arccos(u) - u * np.sqrt(1 - u**2)) / math.pi
    assert ((want > 0.02) & (want < 0.98)).sum() > 8
    np.testing.assert_allclose(got, want[:, None] * IRRADIANCE.numpy(), atol=0.01 * 3)
    np.testing.assert_allclose(got[:20], np.tile(IRRADIANCE.numpy(), (20, 1)), rtol=2e-3)


def test_a_slanted_sun_gives_the_cosine() -> None:
    sun = SunDisc(direction=towards(90.0, 0.0), irradiance=IRRADIANCE)
    slanted = SunDisc(direction=torch.tensor([0.6, 0.0, 0.8]).double(), irradiance=IRRADIANCE)
    mi = mitsuba_variant()
    away = mi.ScalarTransform4f().translate([0, 0, -5.0])
    nothing: dict[str, object] = {"type": "rectangle", "to_world": away}
    got = lit_plane(slanted, nothing, 16)
    np.testing.assert_allclose(got, np.tile(0.8 * IRRADIANCE.numpy(), (64, 1)), rtol=3e-3)
    assert sun.radiance.tolist() == pytest.approx(
        (IRRADIANCE / (math.pi * math.sin(SUN_RADIUS_RAD) ** 2)).tolist()
    )


def test_an_even_disc_is_within_three_percent_of_one_that_darkens_to_its_limb() -> None:
    """Of the share of a sun that an edge at u radii leaves visible."""

    def darkened(x: float) -> float:
        """1 - 0.6 (1 - sqrt(1 - r^2)) along the chord at x."""
        end = math.sqrt(1 - x * x)
        return 2 * quad(lambda y: 0.4 + 0.6 * math.sqrt(max(0.0, 1 - x * x - y * y)), 0, end)[0]

    whole = quad(darkened, -1, 1)[0]
    apart = []
    for u in np.linspace(-0.95, 0.95, 20):
        true = quad(darkened, u, 1)[0] / whole
        even = (math.acos(u) - u * math.sqrt(1 - u * u)) / math.pi
        apart.append(abs(true - even))
    assert 0.015 < max(apart) < 0.03


def test_a_sun_behind_dense_clouds_is_in_the_map_alone() -> None:
    """Scene 2 is overcast: an emitter with a millionth of the light would take half the samples."""
    options = RenderOptions()
    lit = [scene_light(scene, options) for scene in range(4)]
    assert lit[2].light.sun is None
    assert any(one.light.sun is not None for one in lit)
    for one in lit:
        if one.light.sun is not None:
            sky = float(luminance(one.light.diffuse.upper().integrate()))
            assert float(luminance(one.light.sun.irradiance)) > 0.9 * FAINT_SUN * sky
