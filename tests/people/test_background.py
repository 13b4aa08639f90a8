"""What is behind people: places at a finite depth, walls, blur, edits."""

import math
from collections import Counter
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch

from skylight.people._background import (
    INDOORS,
    SHARES,
    Background,
    BackgroundFacts,
    BackgroundKind,
    Edit,
    Lens,
    Panel,
    background,
    draw_background,
    reflected,
)
from skylight.people._light import DistantLight, SunDisc
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angles_from_direction
from skylight.transport._cameras import Camera

CAMERA = Camera(focal_px=96.0, width=48, height=48, center_px=(24.0, 24.0))
HEAD = np.array([0.01, -0.02, -0.7])
TOWARDS = torch.tensor([0.0, 0.0, 1.0])  # from the wall to the camera
WIDE = Lens(focal_mm=50.0, f_number=2.0)


def sun_at(*direction: float) -> SunDisc:
    towards = torch.nn.functional.normalize(torch.tensor(direction).double(), dim=0)
    return SunDisc(direction=towards, irradiance=torch.ones(3))


def varied(seed: int = 0) -> EnvironmentMap:
    """A smooth map, brighter above."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(8, 16, 3, generator=generator) + torch.linspace(2, 0, 8)[:, None, None]
    return EnvironmentMap(radiance=coarse.repeat_interleave(8, 0).repeat_interleave(8, 1))


def named() -> EnvironmentMap:
    """A map whose red is the azimuth and whose green is the zenith angle."""
    plain = EnvironmentMap(radiance=torch.zeros(64, 128, 3))
    azimuth, zenith = angles_from_direction(plain.grid.directions)
    return EnvironmentMap(
        radiance=torch.stack([azimuth, zenith, 0 * zenith], -1).reshape(64, 128, 3).float()
    )


def wall(depth_m: float = 1.0, radiance: np.ndarray | None = None) -> Panel:
    """Wider than any picture here."""
    even = np.full((1, 1, 3), 0.5, np.float32)
    return Panel(
        depth_m=depth_m,
        left=-3.0,
        right=3.0,
        bottom=-3.0,
        top=3.0,
        radiance=even if radiance is None else radiance.astype(np.float32),
    )


def test_a_far_shell_is_the_light_itself() -> None:
    sun = sun_at(0.05, 0.05, -1.0)
    light = DistantLight(varied(), sun)
    want = background(light, CAMERA)
    for far in (1e5, math.inf):
        corners = (-far, -far, -far), (far, far, math.inf)
        seen = Background(kind="room", low=corners[0], high=corners[1]).seen(light, CAMERA, HEAD)
        np.testing.assert_allclose(seen, want, rtol=1e-3, atol=1e-3 * want.max())


def test_the_back_wall_of_a_room_is_seen_from_where_the_camera_is() -> None:
    """At the centre, x metres aside at the wall: azimuth atan(x / depth) from the head."""
    depth = 1.5
    low, high = (-9.0, -9.0, -depth), (9.0, 9.0, math.inf)
    seen = Background(kind="room", low=low, high=high).seen(DistantLight(named()), CAMERA, HEAD)
    for column in (3, 24, 40):
        slope = (column + 0.5 - 24) / CAMERA.focal_px
        x = slope * (depth - HEAD[2]) - HEAD[0]
        assert seen[24, column, 0] == pytest.approx(math.atan(x / depth), abs=0.003)


def test_the_ground_is_seen_where_it_lies_and_the_sky_is_far() -> None:
    eyes = 1.4
    ground = Background(kind="open", low=(-math.inf, -eyes, -math.inf))
    seen = ground.seen(DistantLight(named()), CAMERA, HEAD)
    far = background(DistantLight(named()), CAMERA)
    np.testing.assert_allclose(seen[:24], far[:24], atol=1e-4)
    row = 46
    slope = (row + 0.5 - 24) / CAMERA.focal_px
    # the ground is `eyes` below the head, which is 2 cm below the camera
    ahead = (eyes - HEAD[1]) / slope + HEAD[2]
    assert seen[row, 24, 1] == pytest.approx(math.pi / 2 + math.atan(eyes / ahead), abs=0.003)


def test_blur_keeps_the_mean_and_follows_the_thin_lens() -> None:
    """A bright point on a wall becomes a disc of the circle of confusion, with its power."""
    texture = np.zeros((600, 600, 3))
    texture[300, 300] = 1.0  # 1 cm of a wall of 6 m
    camera = replace(CAMERA, focal_px=400.0, width=160, height=160, center_px=(80.0, 80.0))
    head = np.array([0.0, 0.0, -0.7])
    sharp = Background(kind="wall", panel=wall(1.3, texture))
    blurred = replace(sharp, lens=WIDE)
    dark = DistantLight(EnvironmentMap(radiance=torch.zeros(16, 32, 3)))
    before, after = (one.seen(dark, camera, head)[..., 0] for one in (sharp, blurred))
    assert after.sum() == pytest.approx(before.sum(), rel=0.02)
    # 400 px * 25 mm * (1 / 0.7 m - 1 / 2 m)
    diameter = 400 * 0.025 * (1 / 0.7 - 1 / 2.0)
    assert WIDE.blur_px(camera, 0.7, 2.0) == pytest.approx(diameter)
    _, columns = np.indices(after.shape)
    x = (columns * after).sum() / after.sum()
    spread = (((columns - x) ** 2) * after).sum() / after.sum()
    own = (((columns - x) ** 2) * before).sum() / before.sum()
    # a disc's variance along a line is a quarter of its radius squared
    assert spread - own == pytest.approx(diameter**2 / 16, rel=0.05)


def test_even_light_stays_even_however_it_is_blurred() -> None:
    light = DistantLight(EnvironmentMap(radiance=torch.full((16, 32, 3), 0.7)))
    for low in ((-2.0, -1.5, -3.0), (-math.inf, -1.5, -math.inf)):
        seen = Background(kind="room", low=low, lens=WIDE).seen(light, CAMERA, HEAD)
        np.testing.assert_allclose(seen, 0.7, rtol=1e-5)


def test_a_wall_sends_back_its_albedo_of_its_irradiance() -> None:
    light = varied()
    irradiance = light.irradiance(TOWARDS).double().numpy()
    rng = np.random.default_rng(1)
    texture = rng.uniform(0.8, 1.2, (9, 9, 1))
    texture /= texture.mean()
    albedo = np.array([0.5, 0.4, 0.3])
    radiance = reflected(albedo, texture, irradiance)
    np.testing.assert_allclose(radiance.mean((0, 1)), albedo * irradiance / math.pi, rtol=1e-6)
    most = reflected(np.ones(3), texture, irradiance) * math.pi / irradiance
    assert most.max() <= 0.95 + 1e-9
    # in a furnace with white walls all is as bright as the light
    furnace = EnvironmentMap(radiance=torch.ones(64, 128, 3))
    light_there = furnace.irradiance(TOWARDS).double().numpy()
    white = reflected(np.full(3, 0.95), np.ones((1, 1, 1)), light_there)
    np.testing.assert_allclose(white, 0.95, rtol=2e-3)


def test_a_wall_is_part_of_the_light_and_hides_what_is_behind_it() -> None:
    light = DistantLight(varied(), sun_at(0.0, 0.1, -1.0))
    panel = replace(wall(), left=-1.0, right=1.0, bottom=-1.0, top=1.0)
    with_wall = panel.before(light)
    assert with_wall.sun is None
    directions = light.diffuse.grid.directions
    aside = directions[:, :2].abs().amax(1)
    # a cube's face as its centre sees it: a sixth of the sphere
    covered, apart = directions[:, 2] < -aside - 0.1, directions[:, 2] > -aside + 0.1
    assert float((with_wall.diffuse.flat[covered] - 0.5).abs().max()) < 1e-6
    torch.testing.assert_close(with_wall.diffuse.flat[apart], light.diffuse.flat[apart])
    black = DistantLight(EnvironmentMap(radiance=torch.zeros(64, 128, 3)))
    solid_angle = panel.before(black).diffuse.integrate() / 0.5
    torch.testing.assert_close(solid_angle, torch.full((3,), 4 * math.pi / 6), rtol=2e-3, atol=0)
    beside = DistantLight(varied(), sun_at(0.0, 0.6, 0.8))
    assert panel.before(beside).sun is beside.sun


def test_edits_are_where_they_say() -> None:
    cover = np.zeros((40, 40))
    cover[10:30, 10:30] = 1
    cover[10, 10] = 0.5
    assert (Edit(value=1.0, cut_out=True).where(cover) == (cover == 0)).all()
    disc = Edit(value=0.0, radius=1.0).where(cover)
    assert disc.mean() == pytest.approx(1 - math.pi / 4, abs=0.01)
    assert disc[0, 0]
    assert not disc[20, 20]
    bars = Edit(value=0.0, bars=(0.1, 0.05)).where(cover)
    assert bars[:, :4].all()
    assert bars[:2].all()
    assert not bars[2:38, 4:36].any()


def test_backgrounds_have_their_shares_and_fit_their_places() -> None:
    light = DistantLight(varied())
    drawn = [
        draw_background(np.random.default_rng(k), light, ("outdoors", "home", "car", None)[k % 4])
        for k in range(200)
    ]
    counts = Counter(one.kind for one, _ in drawn)
    assert {*counts} == {*get_args(BackgroundKind)}
    assert sum(SHARES.values()) == pytest.approx(1)
    for kind, share in SHARES.items():
        found = counts[kind] + (counts["room"] if kind == "open" else 0)
        # four standard deviations of the count
        assert abs(found - 200 * share) < 4 * math.sqrt(200 * share * (1 - share))
    for k, (one, lit) in enumerate(drawn):
        assert one.kind != ("room" if k % 4 in (0, 3) else "open")
        assert (lit is light) == (one.panel is None)
        if one.panel is not None:
            assert 0.5 <= one.panel.depth_m <= min(3, -one.low[2])
            assert one.panel.within(one) == one.panel
        assert one.kind == "infinite" or one.lens is not None
        assert (one.edit is not None) == (one.kind in ("cut-out", "round", "border"))
    again, _ = draw_background(np.random.default_rng(3), light, None)
    assert again.kind == drawn[3][0].kind
    assert {"home", "car"} <= {*INDOORS}


def test_the_facts_tell_depth_and_blur() -> None:
    behind = Background(kind="wall", panel=wall(1.3), lens=WIDE)
    facts = BackgroundFacts.of(behind, CAMERA, np.array([0.0, 0.0, -0.7]))
    assert facts.depth_m == 1.3
    assert facts.blur_px == pytest.approx(96 * 0.025 * (1 / 0.7 - 1 / 2))
    far = BackgroundFacts.of(Background(kind="infinite"), CAMERA, HEAD)
    assert (far.depth_m, far.blur_px) == (None, 0.0)
