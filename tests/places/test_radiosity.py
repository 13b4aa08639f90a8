"""What is seen of scenes whose light is known by a law."""

import math

import numpy as np
import pytest
import torch

from skylight.places._materials import lumens
from skylight.places._radiosity import Lit
from skylight.places._scene import (
    BLACK,
    Hole,
    Lamp,
    Material,
    Outside,
    Rectangle,
    Scene,
    black_body,
    box,
    panel,
    pierced,
)
from skylight.places._view import DistinctLight, Rendered, render, spread_out
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._path_tracer import DiffuseScene, Sampling, shade

HEIGHT = 16
DARK = Outside.uniform((0, 0, 0), HEIGHT)
SQUARE = math.pi / HEIGHT


def seen(scene: Scene, height: int = HEIGHT) -> Rendered:
    return render(scene, height=height, generator=torch.Generator().manual_seed(0))


def radiance(scene: Scene, height: int = HEIGHT) -> torch.Tensor:
    """Before it is divided by its mean."""
    rendered = seen(scene, height)
    return rendered.map.radiance * rendered.level


def grey(albedo: float, **more: float) -> Material:
    return Material(albedo=(albedo,) * 3, **more)


def sunlit(zenith_rad: float, **more: float) -> Outside:
    return Outside(
        map=torch.zeros(HEIGHT, 2 * HEIGHT, 3),
        sun=torch.tensor([math.sin(zenith_rad), math.cos(zenith_rad), 0.0]),
        sun_irradiance=torch.tensor([2.0, 1.0, 0.5]),
        **more,
    )


def floor(material: Material) -> Rectangle:
    return panel((0, -1.5, 0), (0, 1, 0), 200, 200, material)


def test_nothing_in_a_uniform_light_is_seen_if_it_is_white() -> None:
    """The furnace: albedo 1, glossy or not, and a map of ones."""
    things = [
        *box((-3, -1, -5), (-1, 2, -3), grey(1)),
        *box((1, -1, -5), (2, 2, -3), grey(1, gloss=0.3), turn_rad=0.4),
        floor(grey(1, gloss=0.05)),
    ]
    everywhere = radiance(Scene(rectangles=things, outside=Outside.uniform((1, 1, 1))))
    # the sum over the map's 64 rows is off by (pi / 64)^2 / 24 for an integral of cosines
    torch.testing.assert_close(everywhere, torch.ones_like(everywhere), rtol=0, atol=5e-4)


def test_a_box_that_shines_is_brighter_by_its_interreflection() -> None:
    """Every wall sends 1 and reflects rho of what all others send: 1 / (1 - rho)."""
    albedo = 0.5, 0.7, 0.2
    walls = box(
        (-2, -1, -3), (2, 2, 3), Material(albedo=albedo), inward=True, radiance=(1.0, 1.0, 1.0)
    )
    light = radiance(Scene(rectangles=walls, outside=DARK, closed=True))
    wanted = torch.tensor([1 / (1 - rho) for rho in albedo])
    torch.testing.assert_close(light.mean((0, 1)), wanted, rtol=0.02, atol=0)
    assert float((light / wanted - 1).abs().max()) < 0.1


def parallel(a: float, b: float, distance: float) -> float:
    """Form factor of a rectangle from below its corner (Howell's catalogue, B-3)."""
    x, y = a / distance, b / distance
    p, q = math.hypot(1, x), math.hypot(1, y)
    return (x / p * math.atan(y / p) + y / q * math.atan(x / q)) / (2 * math.pi)


@pytest.mark.parametrize("way", ["window", "panel"])
def test_a_window_lights_by_its_form_factor(way: str) -> None:
    wall = panel((0, 0, -3), (0, 0, 1), 4, 3)
    room = box((-2, -1.5, -3), (2, 1.5, 3), BLACK, inward=True)
    room = [*room[:4], room[5]]
    if way == "window":
        outside = Outside.uniform((1, 1, 1), HEIGHT)
        room += pierced(wall, [Hole(0.25, 0.75, 1 / 3, 2 / 3)], lamp=0)
    else:
        outside = DARK
        room += [wall, panel((0, 0, -2.999), (0, 0, 1), 2, 1, radiance=(1, 1, 1), lamp=0)]
    lit = Lit(
        Scene(rectangles=room, outside=outside, closed=True), torch.Generator().manual_seed(0)
    )
    distance = 3 if way == "window" else 2.999
    for place, wanted in (
        ((0.0, 0.0, 0.0), 4 * parallel(1, 0.5, distance)),
        (
            (0.5, 0.2, -2.0),
            sum(parallel(a, b, distance - 2) for a in (0.5, 1.5) for b in (0.3, 0.7)),
        ),
    ):
        many = torch.tensor([place]).expand(1000, 3)
        normals = torch.tensor([[0.0, 0.0, -1.0]]).expand(1000, 3)
        each = (lit.from_panels(many, normals, 12, 24) + lit.gathered(many, normals))[:, 1]
        error = float(each.std()) / math.sqrt(1000)
        assert float(each.mean()) == pytest.approx(math.pi * wanted, abs=4 * error + 1e-3)


def test_the_sun_on_the_ground_and_its_record() -> None:
    zenith = math.radians(40)
    scene = Scene(rectangles=[floor(grey(0.5))], outside=sunlit(zenith))
    rendered = seen(scene)
    ground = (rendered.map.radiance * rendered.level)[HEIGHT // 2 + 1 :]
    wanted = 0.5 / math.pi * math.cos(zenith) * torch.tensor([2.0, 1.0, 0.5])
    torch.testing.assert_close(ground, wanted.expand_as(ground), rtol=1e-4, atol=1e-6)
    (sun,) = rendered.lights
    assert (sun.kind, sun.in_map) == ("sun", False)
    torch.testing.assert_close(sun.energy * rendered.level, torch.tensor([2.0, 1.0, 0.5]))
    torch.testing.assert_close(sun.direction, scene.outside.sun)


def test_mean_luminance_is_one_with_the_lights() -> None:
    lamp = Lamp(position=(0.5, 1.0, -2.0), intensity=(3.0, 2.0, 1.0), radius_m=0.01)
    rendered = seen(
        Scene(rectangles=[floor(grey(0.3))], lamps=[lamp], outside=sunlit(1.0), closed=False)
    )
    assert {light.kind for light in rendered.lights} == {"sun", "lamp"}
    total = float(luminance(rendered.map.flat) @ rendered.map.grid.solid_angles.float())
    total += sum(float(luminance(light.energy)) for light in rendered.lights)
    assert total == pytest.approx(4 * math.pi, rel=1e-5)


def test_a_wall_throws_its_shadow_and_hides_the_sun() -> None:
    wall = box((1, -1.5, -50), (1.2, 8, 50), grey(0.0))
    scene = Scene(rectangles=[floor(grey(0.5)), *wall], outside=sunlit(math.radians(60)))
    rendered = seen(scene)
    assert rendered.lights == []
    image = rendered.map.radiance.sum(2)
    below = image[-2]  # of the ground about the viewer's feet
    assert float(below.max()) < 1e-6 * float(image.max())


def test_lamps_follow_the_inverse_square_of_distance() -> None:
    """Below a lamp: I / h^2, times rho / pi; and its energy for the viewer is I / d^2."""
    lamp = Lamp(position=(0.0, 2.5, 0.0), intensity=(8.0, 8.0, 8.0), radius_m=0.01)
    rendered = seen(Scene(rectangles=[floor(grey(0.5))], lamps=[lamp], outside=DARK))
    # at zenith angle z of the last row, on the ground
    down = float(rendered.map.grid.directions[-1, 1])
    away = 1.5 * math.sqrt(1 - down**2) / -down
    square = 4.0**2 + away**2
    wanted = 0.5 / math.pi * 8 * 4 / square**1.5
    found = rendered.map.radiance[-1].mean() * rendered.level
    assert float(found) == pytest.approx(wanted, rel=2e-3)
    (light,) = rendered.lights
    assert float(light.energy[0]) * rendered.level == pytest.approx(8 / 2.5**2, rel=1e-5)
    assert light.radius_rad == pytest.approx(0.01 / 2.5, rel=1e-3)


@pytest.mark.parametrize(("size", "in_map"), [(0.05, False), (2.0, True)])
def test_a_panel_as_a_light(size: float, in_map: bool) -> None:
    """Its energy is radiance times solid angle, in the map or beside it."""
    shines = panel((0, 2, -2), (0, -1, 1), size, size, radiance=(4, 2, 1), lamp=7)
    rendered = seen(Scene(rectangles=[floor(grey(0.1)), shines], outside=DARK), height=32)
    (light,) = rendered.lights
    half, distance = size / 2, 2 * math.sqrt(2)
    solid = 4 * math.asin(half**2 / (half**2 + distance**2))  # of a square, seen from its axis
    assert light.in_map is in_map
    energy = light.energy * rendered.level
    torch.testing.assert_close(energy, solid * torch.tensor([4.0, 2.0, 1.0]), rtol=0.02, atol=0)
    torch.testing.assert_close(
        light.direction, torch.tensor([0.0, 1.0, -1.0]) / math.sqrt(2), rtol=0, atol=0.02
    )
    # a square's mean square distance from its middle is size^2 / 6, a disc's half its radius'
    wanted = math.sqrt(2 * size**2 / 6) / distance
    assert light.radius_rad == pytest.approx(wanted, rel=0.1)
    above = rendered.map.radiance[:16] * rendered.level
    shown = (
        above.flatten(0, 1).double() * DirectionGrid.latlong(32).solid_angles[:1024, None]
    ).sum(0)
    torch.testing.assert_close(
        shown.float(), energy if in_map else torch.zeros(3), rtol=0.03, atol=1e-6
    )


def test_weak_small_lights_stay_in_the_map() -> None:
    """Seven lamps: the six strongest are listed, the last is spread over pixels."""
    lamps = [
        Lamp(position=(2 * math.sin(a), 1.0, -2 * math.cos(a)), intensity=(1 + a,) * 3)
        for a in np.arange(7) * 0.8
    ]
    rendered = seen(Scene(lamps=lamps, outside=DARK))
    assert len(rendered.lights) == 6
    energies = [float(light.energy[0]) for light in rendered.lights]
    assert energies == sorted(energies, reverse=True)
    solid = rendered.map.grid.solid_angles.float()
    left = float(rendered.map.flat[:, 0] @ solid) * rendered.level
    assert left == pytest.approx(1 / 5, rel=1e-4)  # I / d^2 of the weakest


def test_spread_out_keeps_energy() -> None:
    grid = DirectionGrid.latlong(HEIGHT)
    light = DistinctLight(
        kind="lamp",
        direction=torch.tensor([0.6, 0.8, 0.0]),
        energy=torch.tensor([3.0, 2.0, 1.0]),
        radius_rad=0.6,
        in_map=False,
    )
    lobe = spread_out(light, grid, SQUARE)
    solid = grid.solid_angles.float()
    torch.testing.assert_close(solid @ lobe, light.energy)
    square = (grid.directions.float() - light.direction).square().sum(1)
    mean = float((lobe[:, 0] * solid) @ square) / 3.0
    assert mean == pytest.approx(0.6**2 / 2, rel=0.05)


def test_shade_of_far_things_has_its_share() -> None:
    """The ground that the viewer sees from high above is lit by the rest."""
    outside = sunlit(0.3, shade=0.4)
    scene = Scene(rectangles=[panel((0, -40, 0), (0, 1, 0), 400, 400, grey(0.5))], outside=outside)
    ground = radiance(scene, 64)[48:, :, 1].flatten()
    full = 0.5 / math.pi * math.cos(0.3)
    solid = DirectionGrid.latlong(64).solid_angles[48 * 128 :].float()
    assert float(ground @ solid / solid.sum()) / full == pytest.approx(0.6, abs=0.12)
    assert float(ground.min()) < 0.1 * full < 0.9 * full < float(ground.max())


@pytest.mark.parametrize(
    ("kelvin", "x", "y"),
    [(2000.0, 0.5267, 0.4133), (2856.0, 0.4476, 0.4074), (6504.0, 0.3135, 0.3236)],
)
def test_black_bodies(kelvin: float, x: float, y: float) -> None:
    """Chromaticities of the Planckian locus (CIE 15:2004; A is 2856 K)."""
    rgb = np.array(black_body(kelvin))
    assert float(rgb @ [0.2126, 0.7152, 0.0722]) == pytest.approx(1)
    xyz = (
        np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
        @ rgb
    )
    xyz /= xyz.sum()
    assert xyz[0] == pytest.approx(x, abs=0.006)
    assert xyz[1] == pytest.approx(y, abs=0.006)


def test_lumens_are_those_of_a_lambertian_surface() -> None:
    """Flux pi L A, in units of the sun's 133.3 klx."""
    radiance_ = lumens((1, 1, 1), 1000.0, 0.5)
    assert math.pi * 0.5 * radiance_[0] * 133.3e3 == pytest.approx(1000)


def test_a_turned_scene_is_seen_turned() -> None:
    """To the right by a quarter: what was ahead (-Z) stands to the right (+X)."""
    shines = panel((0, 0, -2), (0, 0, 1), 1, 1, radiance=(1, 1, 1), lamp=0)
    scene = Scene(rectangles=[shines], outside=DARK)
    (light,) = seen(scene.seen_from((0, 0, 0), math.pi / 2)).lights
    torch.testing.assert_close(light.direction, torch.tensor([1.0, 0.0, 0.0]), rtol=0, atol=0.02)
    (light,) = seen(scene.seen_from((0.5, 0.0, 0.0))).lights
    assert float(light.direction[0]) < -0.2


def test_a_gloss_mirrors_sky_sun_and_lamps() -> None:
    """A floor that mirrors all: the sky turned over, and lobes of the lights' energies."""
    grid = DirectionGrid.latlong(64)
    sky = (1 + grid.directions[:, :1]).float().expand(-1, 3).reshape(64, 128, 3)
    outside = Outside(map=sky, sun=torch.tensor([0.0, 0.6, -0.8]), sun_irradiance=torch.zeros(3))
    mirror = floor(grey(0.0, gloss=1, roughness=0.1))
    image = radiance(Scene(rectangles=[mirror], outside=outside), 64)
    below = image[40:, :, 0]  # the last rows under the horizon see the sky's rim over it
    torch.testing.assert_close(below, sky[40:, :, 0], rtol=0, atol=0.1)
    assert float((below - sky[40:, :, 0]).mean().abs()) < 2e-3

    dark = torch.zeros(64, 128, 3)
    sun = Outside(map=dark, sun=outside.sun, sun_irradiance=torch.full((3,), 2.0))
    image = radiance(Scene(rectangles=[mirror], outside=sun), 64)[..., 0].flatten()
    assert float(image @ grid.solid_angles.float()) == pytest.approx(2.0, rel=0.02)
    brightest = grid.directions[int(image.argmax())]
    torch.testing.assert_close(
        brightest, torch.tensor([0.0, -0.6, -0.8], dtype=torch.float64), rtol=0, atol=0.05
    )

    # the lamp's image hangs as far under the floor as the lamp over it
    lamp = Lamp(position=(0.0, 1.5, -6.0), intensity=(5.0,) * 3, radius_m=0.01)
    image = radiance(Scene(rectangles=[mirror], lamps=[lamp], outside=DARK), 64)[..., 0].flatten()
    brightest = grid.directions[int(image.argmax())]
    wanted = torch.tensor([0.0, -0.6, -0.8], dtype=torch.float64)
    torch.testing.assert_close(brightest, wanted, rtol=0, atol=0.06)


def test_glare_lights_by_its_cosine_and_is_hidden_without_noise() -> None:
    """A bright patch of sky 40 degrees up, on a floor in the open, then behind a wall."""
    light = torch.full((HEIGHT, 2 * HEIGHT, 3), 0.1)
    light[4, 6:8] = torch.tensor([60.0, 50.0, 40.0])
    outside = Outside(map=light, sun=torch.tensor([0.0, 1.0, 0.0]), sun_irradiance=torch.zeros(3))
    grid = DirectionGrid.latlong(HEIGHT)
    weight = (grid.directions[:, 1].clamp(min=0) * grid.solid_angles).float()
    open_floor = floor(grey(0.3))
    below = radiance(Scene(rectangles=[open_floor], outside=outside))[-3:]
    wanted = 0.3 / math.pi * (weight @ light.reshape(-1, 3))
    torch.testing.assert_close(below, wanted.expand_as(below), rtol=5e-3, atol=0)
    azimuth = 2 * math.pi * (7 / (2 * HEIGHT) - 0.5)
    towards = np.array([math.sin(azimuth), 0, -math.cos(azimuth)])
    wall = panel(8 * towards, -towards, 60, 40, BLACK)
    beside = radiance(Scene(rectangles=[open_floor, wall], outside=outside))[-3:]
    # of the even light the wall leaves more than a half
    assert float(beside.min()) > 0.5 * 0.3 * 0.1
    assert float(beside.max()) < 0.3 * 0.1


def test_nothing_is_darker_than_black() -> None:
    """Under a low roof rays take off all of the sky, but for their noise."""
    azimuth = 2 * math.pi * (torch.arange(2 * HEIGHT) + 0.5) / (2 * HEIGHT)
    light = (1 + 0.9 * azimuth.cos())[:, None].expand(HEIGHT, 2 * HEIGHT, 3)
    outside = Outside(map=light, sun=torch.tensor([0.0, 1.0, 0.0]), sun_irradiance=torch.zeros(3))
    ground = panel((0, -1.5, -30), (0, 1, 0), 20, 20, grey(0.8))
    roof = panel((0, -1.49, -30), (0, -1, 0), 20, 20, grey(0.8))
    lit = Lit(Scene(rectangles=[ground, roof], outside=outside), torch.Generator().manual_seed(0))
    assert float(lit.radiosity.min()) >= 0


def test_texture_is_as_fine_as_pixels_see_it() -> None:
    """Of 10 cm, on the ground 1.5 m and 150 m below."""

    def spread(eye: float) -> float:
        grain = grey(0.3, texture=0.4, grain_m=0.1)
        ground = panel((0, -eye, 0), (0, 1, 0), 200 * eye, 200 * eye, grain)
        light = radiance(Scene(rectangles=[ground], outside=Outside.uniform((1, 1, 1))))
        return float(light[-4:, :, 1].log().std())

    near, far = spread(1.5), spread(150.0)
    assert near > 0.05
    assert far < 0.1 * near


def test_boxes_are_closed() -> None:
    """Their sides' normals, times areas, sum to nothing, and point out, or in."""
    for inward in (False, True):
        sides = box((1, 2, 3), (2, 4, 6), BLACK, turn_rad=0.7, inward=inward)
        normals = np.array([np.cross(each.along, each.across) for each in sides])
        middles = np.array([each.corner + (each.along + each.across) / 2 for each in sides])
        np.testing.assert_allclose(normals.sum(0), 0, atol=1e-12)
        outward = ((middles - [1.5, 3, 4.5]) * normals).sum(1)
        assert (outward < 0).all() if inward else (outward > 0).all()
        assert ((middles - [1.5, 3, 4.5]) * normals).sum() == pytest.approx(
            (-1 if inward else 1) * 3 * 1 * 2 * 3
        )  # thrice the volume, by Gauss


def test_a_pierced_wall_keeps_its_area() -> None:
    wall = panel((0, 0, 0), (0, 0, 1), 4, 3)
    parts = pierced(wall, [Hole(0.1, 0.3, 0.2, 0.9), Hole(0.5, 0.8, 0.4, 0.9)], lamp=3)
    areas = [float(np.linalg.norm(np.cross(each.along, each.across))) for each in parts]
    assert math.fsum(areas) == pytest.approx(12)
    windows = [(each.lamp, a) for each, a in zip(parts, areas, strict=True) if each.window]
    assert windows == [(3, pytest.approx(12 * 0.14)), (4, pytest.approx(12 * 0.15))]


@pytest.mark.parametrize("closed", [True, False])
def test_light_is_that_of_the_path_tracer(closed: bool) -> None:
    """Points on surfaces of one albedo under an uneven map: a room with a window, and outdoors."""
    grid = DirectionGrid.latlong(HEIGHT)
    level = torch.exp(grid.directions @ torch.tensor([0.5, 1.0, -1.5], dtype=torch.float64)).float()
    outside = Outside(
        map=level[:, None].expand(-1, 3).reshape(HEIGHT, 2 * HEIGHT, 3),
        sun=torch.tensor([0.0, 1.0, 0.0]),
        sun_irradiance=torch.zeros(3),
    )
    material = grey(0.6)
    things = box((-0.8, -1.5, -1.5), (0.2, -0.6, -0.5), material)
    if closed:
        walls = box((-2, -1.5, -3), (2, 1.5, 3), material, inward=True)
        wall = panel((0, 0, -3), (0, 0, 1), 4, 3, material)
        things += [*walls[:4], walls[5], *pierced(wall, [Hole(0.2, 0.8, 0.4, 0.9)])]
    else:
        things += [panel((0, -1.5, 0), (0, 1, 0), 8, 8, material)]
        things += box((1, -1.5, -2), (2, 1, 2), material)
    lit = Lit(
        Scene(rectangles=things, outside=outside, closed=closed), torch.Generator().manual_seed(0)
    )
    corners = lit.surfaces.corner, lit.surfaces.along, lit.surfaces.across
    c, a, b = (each.double() for each in corners)
    vertices = torch.stack([c, c + a, c + a + b, c + b], 1).reshape(-1, 3)
    first = 4 * torch.arange(len(c))[:, None, None]
    faces = (first + torch.tensor([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    places = torch.tensor([[0.9, -1.5, -1.0], [-0.3, -0.6, -1.0], [-1.2, -1.5, 0.5]])
    normals = torch.tensor([[0.0, 1.0, 0.0]]).expand(3, 3)
    wanted = shade(
        places,
        normals,
        DiffuseScene.uniform(vertices, faces, 0.6),
        EnvironmentMap(radiance=outside.map),
        albedo=0.6,
        sampling=Sampling(samples=2048, batches=4),
        generator=torch.Generator().manual_seed(1),
    )
    many = (places + 1e-3 * normals).repeat(300, 1)
    up = normals.repeat(300, 1)
    found = 0.6 / math.pi * (lit.from_panels(many, up, 12, 24) + lit.gathered(many, up))[:, 1]
    found = found.reshape(300, 3)
    error = found.std(0) / math.sqrt(300) + wanted.standard_error[:, 1]
    # beside noise: patches are constant, and a sum over 16 rows is off by (pi / 16)^2 / 24
    assert ((found.mean(0) - wanted.mean[:, 1]).abs() < 4 * error + 0.02 * wanted.mean[:, 1]).all()
