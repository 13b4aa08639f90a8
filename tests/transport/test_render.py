import math

import pytest
import torch

from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from skylight.transport._render import Specular, ggx, light_samples, render_diffuse
from skylight.transport._scene import diffuse_surface, evaluation_scene
from tests.transport.shapes import seen_sphere


def sunny(azimuth_deg, zenith_deg, height=64, sun=20000.0):
    grid = DirectionGrid.latlong(height)
    sun_at = direction_from_angles(
        torch.tensor(math.radians(azimuth_deg)), torch.tensor(math.radians(zenith_deg))
    ).double()
    radiance = torch.ones(len(grid), 3)
    radiance[(grid.directions @ sun_at).argmax()] = sun
    return EnvironmentMap(radiance=radiance.reshape(height, -1, 3))


@pytest.mark.parametrize("height", [16, 64, 512])
def test_light_samples_keep_the_energy(height):
    environment = sunny(40, 50, height)
    directions, flux = light_samples(environment)
    torch.testing.assert_close(flux.sum(0).float(), environment.integrate(), rtol=1e-5, atol=0)
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(len(flux), dtype=torch.float64))


def test_the_sun_becomes_many_directions():
    plain, _ = light_samples(EnvironmentMap(radiance=torch.ones(64, 128, 3)))
    assert len(plain) == 32 * 64
    assert len(light_samples(sunny(0, 45))[0]) == 32 * 64 + 16


def test_furnace():
    gbuffer, caster = seen_sphere(subdivisions=3, height=24)
    albedo = torch.full((len(gbuffer), 3), 0.4)
    white = EnvironmentMap(radiance=torch.ones(64, 128, 3))
    torch.testing.assert_close(
        render_diffuse(gbuffer, white, albedo, caster), albedo, atol=1e-3, rtol=0
    )


def test_a_sphere_in_the_sun_follows_the_cosine():
    gbuffer, caster = seen_sphere(subdivisions=4, height=24)
    environment = sunny(120, 60)  # behind the camera's right shoulder
    albedo = torch.ones(len(gbuffer), 3)
    got = render_diffuse(gbuffer, environment, albedo, caster)
    grid = environment.grid
    cosine = (gbuffer.normals @ grid.directions.T).clamp(min=0) * grid.solid_angles / math.pi
    # 4 x 4 directions of the sun's pixel, 2.8 degrees wide, blur the terminator; its peak is 12
    torch.testing.assert_close(got, cosine.float() @ environment.flat, atol=0.1, rtol=0.01)


@pytest.mark.parametrize(
    ("roughness", "albedo"), [(0.4, [0.967, 0.956, 0.880]), (0.8, [0.555, 0.574, 0.708])]
)
def test_the_specular_lobe_is_reciprocal_and_keeps_its_directional_albedo(roughness, albedo):
    # albedo: E[G2 <v,h> / (<n,v> <n,h>)] over 400,000 normals sampled from GGX, in numpy
    lobe, grid = Specular(f0=1.0, roughness=roughness), DirectionGrid.hammersley(40000)
    light = grid.directions[grid.directions[:, 1] > 0]
    views = torch.stack([torch.tensor([math.sin(a), math.cos(a), 0]) for a in (0.1, 0.7, 1.3)])
    n_l, n_v = light[:, 1:2], views[:, 1].double()
    value = ggx(n_l.expand(-1, 3), n_v, light @ views.T.double(), lobe)
    reflected = (value * n_l).sum(0) * 4 * math.pi / len(grid)
    assert reflected.tolist() == pytest.approx(albedo, abs=5e-3)
    one, other = light[100], views[1].double()
    there = ggx(one[1].reshape(1, 1), other[1:2], (one @ other).reshape(1, 1), lobe)
    back = ggx(other[1].reshape(1, 1), one[1:2], (one @ other).reshape(1, 1), lobe)
    torch.testing.assert_close(there, back)


def test_the_specular_lobe_only_adds_light():
    gbuffer, caster = seen_sphere(subdivisions=3, height=24)
    albedo = torch.full((len(gbuffer), 3), 0.4)
    environment = sunny(120, 60)
    diffuse = render_diffuse(gbuffer, environment, albedo, caster)
    shiny = render_diffuse(gbuffer, environment, albedo, caster, specular=Specular())
    assert (shiny >= diffuse).all()
    assert (shiny > diffuse + 0.01).any()


@pytest.fixture(scope="module")
def scene():
    return evaluation_scene(36, 16)


def test_scene_shading_is_linear_and_keeps_the_ground_below_its_albedo(scene):
    white = EnvironmentMap(radiance=torch.ones(16, 32, 3))
    sun = sunny(30, 40, height=16)
    both = EnvironmentMap(radiance=white.radiance + sun.radiance)
    apart = scene.shade(white) + scene.shade(sun)
    torch.testing.assert_close(scene.shade(both), apart, rtol=1e-4, atol=1e-5)
    shade = scene.shade(white)
    assert (shade < 1.01 * scene.albedo).all()
    ground = scene.albedo[:, 0] == 0.5
    assert shade[ground].max() > 0.98 * 0.5  # open ground sees nearly all of the sky


@pytest.mark.parametrize("azimuth_deg", [-100, 100, 30])
def test_shadows_fall_where_the_sun_is_hidden(scene, azimuth_deg):
    environment = sunny(azimuth_deg, 60, height=16)
    sun = environment.grid.directions[environment.flat[:, 0].argmax()]
    lit = scene.shade(environment)[:, 0]
    surface, _, _ = diffuse_surface(scene.camera)
    ground = (scene.albedo[:, 0] == 0.5) & (surface.normals[:, 1] > 0.99)
    dark = lit < 0.5 * lit[ground].max()

    def passes(centre, radius):
        """Where the ray to the sun comes closer to ``centre`` than ``radius``."""
        offset = torch.tensor(centre, dtype=torch.float64) - surface.positions
        along = offset @ sun
        return ((offset - along[:, None] * sun).norm(dim=1) < radius) & (along > 0)

    in_shadow = ground & passes((-1.1, -1.08, -3.3), 0.41)  # the ball's
    assert in_shadow.sum() > 5
    assert dark[in_shadow].all()
    hidden = passes((-1.1, -1.08, -3.3), 0.43)  # and spheres about the other objects
    hidden |= passes((-0.35, -1.05, -4.3), 0.62) | passes((1.15, -1.01, -3.5), 0.52)
    hidden |= passes((0.2, -0.95, -3.1), 0.8)
    assert (ground & ~hidden).sum() > 100
    assert not dark[ground & ~hidden].any()


def test_relit_pictures_show_the_environment_behind(scene):
    environment = EnvironmentMap(radiance=torch.full((16, 32, 3), 2.0))
    for picture in (scene.relight(environment), scene.relight_specular(environment)):
        assert picture.shape == (36, 48, 3)
        torch.testing.assert_close(picture[0, 0], torch.full((3,), 2.0))
    # a constant light is reflected whole by every metal pixel
    row, column = scene.metal.pixels[0]
    assert scene.relight_specular(environment)[row, column].tolist() == pytest.approx([1.8] * 3)


def test_a_sky_without_ground_is_refused(scene):
    sky = EnvironmentMap(radiance=torch.ones(8, 32, 3))
    for use in (scene.relight, light_samples):
        with pytest.raises(ValueError, match="with_ground"):
            use(sky)
