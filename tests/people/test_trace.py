"""Mitsuba's layers against our own renderer: axes, units, and what the light's map becomes."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba", reason="mitsuba is not installed")

from skylight.people._light import DistantLight, RenderOptions, SunDisc
from skylight.people._people import Person, person, seen_parts
from skylight.people._skin import SmoothHead
from skylight.people._subsurface import SkinPatches, patches_in_reach
from skylight.people._trace import INDEX, Layers, fine_map, trace, window
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import convert_latlong
from skylight.transport._rays import Raycaster
from skylight.transport._render import Specular, rasterize, render_diffuse

SIZE = 48
OPTIONS = RenderOptions(size=SIZE)


@cache
def grey_person(albedo: float) -> Person:
    who = person(4, 2.0, OPTIONS)
    colours = replace(
        who.paint,
        albedo=np.full_like(who.paint.albedo, albedo),
        roughness=np.full_like(who.paint.roughness, 0.5),
    )
    return replace(who, paint=colours)


@cache
def some_patches(every: int) -> SkinPatches:
    """Some of the patches of the grey person, whatever the colours: each has rays of its own."""
    someone = person(4, 2.0, OPTIONS)
    whole = vars(patches_in_reach(someone, seen_parts(someone), 0.01))
    return SkinPatches(**{name: values[::every] for name, values in whole.items()})


def layers_of(who: Person, light: EnvironmentMap, *, samples: int, seed: int) -> Layers:
    return trace(who, DistantLight(light), some_patches(50), samples=samples, seed=seed)


def sunny(row: int, column: int) -> EnvironmentMap:
    """A bluish sky over brown ground with a sun of one pixel, of the sky's power."""
    radiance = torch.tensor([0.5, 0.7, 1.0]).expand(16, 32, 3).clone()
    radiance[8:] = torch.tensor([0.2, 0.15, 0.1])
    radiance[row, column] = 120.0
    return EnvironmentMap(radiance=radiance)


@pytest.mark.parametrize("column", [3, pytest.param(28, marks=pytest.mark.slow)])
def test_layers_agree_with_our_own_renderer(column: int) -> None:
    who, light = grey_person(0.05), sunny(5, column)
    layers = layers_of(who, light, samples=49, seed=0)
    mesh, faces = torch.from_numpy(who.points), torch.from_numpy(SmoothHead.load().faces.copy())
    caster = Raycaster(mesh, faces)
    surface = rasterize(who.truth.camera, mesh, faces, caster)
    albedo = torch.full((len(surface), 3), 0.05)
    diffuse = render_diffuse(surface, light, albedo, caster, fine_height=128)
    lobe = Specular(f0=((INDEX - 1) / (INDEX + 1)) ** 2, roughness=0.5)
    both = render_diffuse(surface, light, albedo, caster, specular=lobe, fine_height=128)
    rows, columns = surface.pixels.unbind(1)
    bare = torch.from_numpy(seen_parts(who).bare)[rows, columns]
    # Schlick's formula, ours, is up to a quarter below Fresnel's for light at 60 degrees
    for ours, theirs, low, high in (
        (diffuse, layers.diffuse, 0.97, 1.03),
        (both - diffuse, layers.specular, 0.97, 1.2),
    ):
        a, b = ours[bare].numpy(), theirs[rows, columns][bare.numpy()]
        ratio = b.mean(0) / a.mean(0)
        assert low < ratio.min() <= ratio.max() < high
        assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.9  # pixels against their centres


def test_the_sun_lights_its_own_side() -> None:
    """Azimuth grows to the picture's right; the person looks at the camera."""
    who = grey_person(0.05)
    bare = seen_parts(who).bare
    columns = np.nonzero(bare)[1]
    left = bare & (np.arange(SIZE)[None] < np.median(columns))
    for column, brighter in ((6, left), (26, bare & ~left)):  # a sun behind the camera
        light = layers_of(who, sunny(4, column), samples=16, seed=1).diffuse.mean(2)
        other = bare & ~brighter
        assert light[brighter].mean() > 1.2 * light[other].mean()


def test_skin_throws_light_onto_skin() -> None:
    """An even light makes a convex body as bright as its albedo, a face darker: less so if pale."""
    white = EnvironmentMap(radiance=torch.ones(16, 32, 3))
    pale, dark = (
        layers_of(grey_person(albedo), white, samples=32, seed=2).diffuse / albedo
        for albedo in (0.8, 0.05)
    )
    bare = seen_parts(grey_person(0.8)).bare
    assert dark[bare].mean() < pale[bare].mean() - 0.02
    assert 0.8 < dark[bare].mean() < pale[bare].mean() < 1.0


def test_layers_say_what_colour_they_show_and_what_they_cover() -> None:
    layers = layers_of(grey_person(0.3), sunny(5, 3), samples=16, seed=3)
    np.testing.assert_allclose(layers.albedo, 0.3 * layers.cover[..., None].repeat(3, 2), atol=1e-5)
    assert layers.cover.max() == 1
    assert layers.cover[0, 0] == 0
    top, left, height, width = window(grey_person(0.3))
    outside = np.ones((SIZE, SIZE), bool)
    outside[top : top + height, left : left + width] = False
    assert outside.any()
    assert layers.cover[outside].max() == 0


def test_the_finer_map_interpolated_as_mitsuba_does_keeps_each_pixels_light() -> None:
    light = EnvironmentMap(
        radiance=torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0))
    )
    fine = fine_map(light).astype(float)
    rows, columns = fine.shape[:2]
    assert (rows, columns) == (65, 128)
    v = (np.arange(4096) + 0.5) / 4096 * (rows - 1)
    low = np.floor(v).astype(int)
    line = fine[low] * (1 - (v - low))[:, None, None] + fine[low + 1] * (v - low)[:, None, None]
    weight = np.sin(math.pi * (np.arange(4096) + 0.5) / 4096)
    ours = convert_latlong(light.radiance, "skylight", "mitsuba").numpy()
    want = np.einsum("r,rwc->c", weight.reshape(8, -1).sum(1), ours) / 16
    got = np.einsum("r,rwc->c", weight, line) / columns
    np.testing.assert_allclose(got, want, rtol=3e-3)
    np.testing.assert_array_equal(fine[4::8][:8, 4::8], ours)


def test_what_enters_patches_is_what_the_pixels_that_show_them_send_back() -> None:
    """And those that none shows get theirs by rays of their own: checked where both are known."""
    who, light, known = grey_person(0.3), sunny(5, 20), some_patches(6)
    shown = np.flatnonzero(known.pixel >= 0)
    layers = trace(who, DistantLight(light), known, samples=64, seed=4)
    sent = layers.diffuse.reshape(-1, 3) / layers.albedo.reshape(-1, 3).clip(1e-6)
    np.testing.assert_allclose(layers.entering[shown], sent[known.pixel[shown]])
    blind = replace(known, pixel=np.full_like(known.pixel, -1))
    own = trace(who, DistantLight(light), blind, samples=64, seed=5).entering
    assert own[shown].mean() / layers.entering[shown].mean() == pytest.approx(1, abs=0.03)
    assert np.corrcoef(own[shown, 1], layers.entering[shown, 1])[0, 1] > 0.9
    hidden = np.flatnonzero(known.pixel < 0)
    assert own[hidden].mean() / layers.entering[hidden].mean() == pytest.approx(1, abs=0.02)


def test_a_sun_as_a_disc_gives_what_one_in_a_pixel_gives() -> None:
    """The same irradiance from the middle of that pixel, so alike but for the shadows' edges."""
    who, pixel = grey_person(0.05), 21 * 128 + 80
    below = sunny(5, 20).resize(64).radiance.contiguous()
    below[20:24, 80:84] = torch.tensor([0.5, 0.7, 1.0])
    radiance = below.clone()
    radiance.view(-1, 3)[pixel] = 2000.0
    light = EnvironmentMap(radiance=radiance)
    grid = light.grid
    irradiance = (2000.0 - below.view(-1, 3)[pixel]) * grid.solid_angles[pixel].float()
    disc = SunDisc(direction=grid.directions[pixel], irradiance=irradiance)
    parted = DistantLight(EnvironmentMap(radiance=below), disc)
    torch.testing.assert_close(parted.environment.radiance, light.radiance, rtol=1e-3, atol=1e-3)
    one = layers_of(who, light, samples=36, seed=6)
    two = trace(who, parted, some_patches(50), samples=36, seed=6)
    bare = seen_parts(who).bare
    for name in ("diffuse", "specular"):
        a, b = getattr(one, name)[bare], getattr(two, name)[bare]
        assert b.mean() / a.mean() == pytest.approx(1, abs=0.03)
    assert np.corrcoef(one.diffuse[bare, 1], two.diffuse[bare, 1])[0, 1] > 0.95
    np.testing.assert_array_equal(one.cover, two.cover)  # the disc hides nothing
