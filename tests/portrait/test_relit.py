"""A portrait taken apart and put together in another light."""

import math
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.faces._model import Region
from skylight.faces._observe import SKIN_SPECULAR
from skylight.imaging._edits import UNEDITED, Edit
from skylight.portrait._gain import (
    BRIGHTER,
    DARKER,
    HUE,
    SkinColour,
    Surface,
    bounded,
    colour_of,
    float32,
    level_of,
    soft_matte,
)
from skylight.portrait._relit import MOST_SPECULAR, Keep, Portrait, shared_light, upright_irradiance
from skylight.portrait._room import OTHER_BRIGHTER, OTHER_DARKER, base_of
from skylight.portrait._surface import (
    BUST,
    PersonSurface,
    Shading,
    region_image,
    scaled,
    softened,
)
from skylight.sphere._envmap import LUMINANCE, EnvironmentMap
from skylight.transport._reflection import specular_lobe
from tests.sunny_face import direction, sunny_face

SPECULAR_SCALE = 0.8
LUMINANCE_ = np.array(LUMINANCE)
ALBEDO = np.array([0.45, 0.3, 0.22], np.float32)


def even(level: float = 1.0, rows: int = 64) -> EnvironmentMap:
    return EnvironmentMap(radiance=torch.full((rows, 2 * rows, 3), level))


@cache
def sunny(azimuth_deg: float, zenith_deg: float) -> EnvironmentMap:
    return even(0.4).with_light(direction(azimuth_deg, zenith_deg), torch.tensor([2.0, 1.8, 1.5]))


@cache
def person() -> PersonSurface:
    return PersonSurface.of(sunny_face(40.0, 50.0).truth, face_px=40)


@cache
def shade(light: EnvironmentMap) -> Shading:
    return person().shade(light, SKIN_SPECULAR)


def image(light: EnvironmentMap, albedo: np.ndarray = ALBEDO) -> np.ndarray:
    """The person by its own model, before black: all of one albedo, skin with specular reflection.

    The rest, where the model traces no light, is lit by all that its normals face.
    """
    one, white = person(), torch.from_numpy(albedo)
    facing = (one.surface.normals.float() @ light.grid.directions.float().T).clamp(min=0)
    lit = white * ((facing * light.grid.solid_angles.float() / math.pi) @ light.flat.float())
    lit[one.skin] = (white * shade(light).diffuse + SPECULAR_SCALE * shade(light).specular)[
        one.skin
    ]
    return one.surface.image(lit).numpy()


def portrait(
    light: EnvironmentMap,
    picture: np.ndarray,
    *,
    hair: float = 0.0,
    grey: bool = False,
    edit: Edit = UNEDITED,
) -> Portrait:
    return Portrait.of(
        torch.from_numpy(picture),
        person(),
        light,
        SPECULAR_SCALE,
        np.full(picture.shape[:2], hair, np.float32),
        (region_image(person()) >= 0).astype(np.float32),
        grey=grey,
        edit=edit,
    )


@cache
def of_the_model(light: EnvironmentMap) -> Portrait:
    return portrait(light, image(light))


def on_skin() -> np.ndarray:
    return np.isin(region_image(person()), (Region.FACE, Region.NECK))


def test_a_softened_map_keeps_light_where_it_is() -> None:
    """No cell has all of a sun, and every plane receives what it did."""
    light, soft = sunny(-50.0, 40.0), softened(sunny(-50.0, 40.0))
    torch.testing.assert_close(
        soft.integrate().double(), light.integrate().double(), rtol=1e-4, atol=0
    )
    for normal in ([0.0, 1.0, 0.0], [-0.6, 0.0, 0.8], [0.0, 0.0, 1.0]):
        one, other = (each.irradiance(torch.tensor(normal)) for each in (soft, light))
        torch.testing.assert_close(one.double(), other.double(), rtol=0.01, atol=0.01)
    share = (soft.flat - 0.4).clamp(min=0)[:, 0] * soft.grid.solid_angles
    assert 0.2 < share.max() / share.sum() < 0.99


def test_shading_in_the_open_is_lamberts_and_the_lobes() -> None:
    """Of what sees all about the sun: ``E <n, d> / pi`` and ``E f_s <n, d>`` more than the rest."""
    one, towards = person(), direction(-50.0, 40.0).float()
    grid = one.sight.grid
    near = (grid.directions.float() @ towards) > math.cos(math.radians(12))
    cosine = one.normals.float() @ towards
    free = one.sight.visible[:, near].all(1) & (cosine > 0.4)
    assert free.sum() > 15
    sun = torch.tensor([2.0, 1.8, 1.5])
    lit, rest = shade(sunny(-50.0, 40.0)), shade(even(0.4))
    want = cosine[free, None] * sun / math.pi
    torch.testing.assert_close(
        (lit.diffuse - rest.diffuse)[one.skin][free], want, rtol=0.03, atol=0.005
    )
    positions = one.surface.positions[one.skin]
    views = -torch.nn.functional.normalize(positions, dim=1).float()
    lobe = specular_lobe(one.normals.float(), views, towards[None], SKIN_SPECULAR)
    want = (lobe * cosine[:, None])[free] * sun
    off = ((lit.specular - rest.specular)[one.skin][free] - want).abs().mean()
    assert off < 0.1 * want.mean()  # the lobe is narrower than the light


def test_the_bust_is_seen_and_keeps_light_from_the_neck() -> None:
    """More than half of what the neck faces below is hidden: an isolated neck would see most."""
    one = person()
    assert (one.regions == BUST).sum() > 20
    assert (one.regions[one.skin] == Region.FACE).sum() > 500
    assert not (one.regions[one.skin] == BUST).any()
    neck = one.regions[one.skin] == Region.NECK
    below = one.sight.grid.directions[:, 1] < -0.7
    facing = one.normals.float() @ one.sight.grid.directions.float().T > 0
    seen = (one.sight.visible & facing)[neck][:, below].float().sum()
    assert seen < 0.5 * facing[neck][:, below].float().sum()


def test_the_same_light_gives_the_same_picture() -> None:
    rng = np.random.default_rng(1)
    light = sunny(40.0, 50.0)
    noisy = image(light) * rng.uniform(0.3, 2.0, image(light).shape).astype(np.float32)
    picture, exposure = portrait(light, noisy).under(light)
    assert exposure == 1.0
    np.testing.assert_allclose(picture, noisy, atol=2e-6)


@pytest.mark.parametrize("keep", ["nothing", "brightness"])
def test_a_person_of_the_model_is_relit_as_the_model_is(keep: Keep) -> None:
    old, new = sunny(50.0, 45.0), sunny(-60.0, 35.0)
    picture, exposure = of_the_model(old).under(new, keep=keep)
    want = exposure * image(new)
    inner = region_image(person()) == Region.FACE
    error = np.abs(picture - want)[inner].mean() / want[inner].mean()
    unchanged = np.abs(image(old) * exposure - want)[inner].mean() / want[inner].mean()
    assert error < 0.1  # shading is smoothed by 2 % of the face's height, and gains are bounded
    assert unchanged > 0.15
    if keep == "brightness":
        lum = np.array([0.2126, 0.7152, 0.0722])
        before, after = (shade(each).diffuse.numpy() for each in (old, new))
        shown = on_skin()[tuple(person().surface.pixels.numpy().T)]
        ratio = (before[shown] @ lum).mean() / (after[shown] @ lum).mean()
        assert exposure == pytest.approx(ratio, rel=0.05)  # of lips, brows and ears as well


def test_a_moved_light_keeps_the_colour_of_skin_and_what_lies_behind() -> None:
    old = sunny(50.0, 45.0)
    blue = EnvironmentMap(radiance=sunny(-60.0, 35.0).radiance * torch.tensor([0.5, 0.8, 1.6]))
    seen = image(old)
    behind = region_image(person()) < 0
    seen[behind] = 0.25
    one = portrait(old, seen)
    moved, _ = one.under(blue, keep="place")
    elsewhere, _ = one.under(blue)
    skin = on_skin()

    def hue(picture: np.ndarray) -> np.ndarray:
        mean = picture[skin].mean(0)
        return mean / mean.sum()

    np.testing.assert_allclose(hue(moved), hue(seen), atol=0.01)
    assert hue(elsewhere)[2] > hue(seen)[2] + 0.05
    far = np.zeros_like(behind)
    far[:3, :3] = True
    np.testing.assert_allclose(moved[far & behind], 0.25, atol=1e-6)
    ratio = (upright_irradiance(blue) / upright_irradiance(old)).numpy()
    np.testing.assert_allclose(elsewhere[far & behind], 0.25 * np.tile(ratio, (9, 1)), rtol=1e-4)


@pytest.mark.parametrize("keep", ["nothing", "brightness", "place"])
def test_twice_the_exposure_is_twice_the_picture(keep: Keep) -> None:
    old, new = sunny(50.0, 45.0), sunny(-60.0, 35.0)
    single, one = of_the_model(old).under(new, keep=keep)
    double, two = of_the_model(old).under(new, 2.0, keep=keep)
    assert two == 2 * one
    np.testing.assert_array_equal(double, 2 * single)


def test_specular_reflection_is_no_more_than_a_part_of_what_skin_shows() -> None:
    """A blue channel taken for specular reflection alone would leave no diffuse one there."""
    light = sunny(40.0, 50.0)
    seen = image(light)
    seen[..., 2] *= 0.2
    one = portrait(light, seen)
    skin = one.on.bare > 0
    assert one.specular_scale < SPECULAR_SCALE
    _, specular = one.shaded_by(light)
    np.testing.assert_allclose(specular, one.specular, rtol=1e-5)
    shares = specular[skin].mean(0) / seen[skin].mean(0)
    assert shares.max() == pytest.approx(MOST_SPECULAR, rel=1e-4)
    assert of_the_model(light).specular_scale == SPECULAR_SCALE


def test_what_the_limit_of_specular_reflection_costs_the_darkest_skin() -> None:
    """Half of the blue that it shows is specular reflection and is cut: highlights stay in part."""
    dark = np.array([0.08, 0.045, 0.03], np.float32)
    old, new = sunny(50.0, 45.0), sunny(-60.0, 35.0)
    one = portrait(old, image(old, dark))
    assert 0.5 * SPECULAR_SCALE < one.specular_scale < 0.9 * SPECULAR_SCALE
    picture, _ = one.under(new)
    want, inner = image(new, dark)[on_skin()], on_skin()
    error = np.abs(picture[inner] - want).mean() / want.mean()
    assert error < 0.15  # 0.27 where nothing is relit


def test_neck_and_clothes_follow_the_face() -> None:
    """In light from the left as well as from the right: brighter on that side, and by less."""
    old = even(0.4)
    deep = cv2.erode((region_image(person()) == BUST).astype(np.uint8), np.ones((3, 3))) > 0
    columns = np.indices(deep.shape)[1]
    for azimuth, sign in ((-120.0, -1), (120.0, 1)):
        picture, _ = of_the_model(old).under(sunny(azimuth, 60.0), keep="brightness")
        gain = np.log((picture @ LUMINANCE_ + 1e-6) / (image(old) @ LUMINANCE_ + 1e-6))
        slopes = [
            np.polyfit(columns[where], gain[where], 1)[0]
            for where in (on_skin(), region_image(person()) == Region.NECK, deep)
        ]
        of_face, *others = (sign * slope for slope in slopes)
        assert all(0.002 < slope < 0.95 * of_face for slope in others)
        # bounded about the mean of the face, which is near 0
        assert gain[deep].max() < OTHER_BRIGHTER + 0.3
        assert gain[deep].min() > -OTHER_DARKER - 0.3


def test_what_is_known_of_the_face_is_continued_smoothly() -> None:
    """A constant stays one, the face keeps its own, and far away no edge is left."""
    on = of_the_model(even()).on
    flat = np.full(on.face.shape, 0.3, np.float32)
    np.testing.assert_allclose(on.continued(flat), 0.3, atol=1e-4)
    columns = np.indices(on.face.shape)[1].astype(np.float32)
    middle = columns[on.face > 0].mean()
    sides = np.where(on.face > 0, np.sign(columns - middle), 9).astype(np.float32)
    whole = on.continued(sides)
    inner = cv2.erode(on.face, np.ones((5, 5), np.uint8)) > 0
    np.testing.assert_allclose(whole[inner], sides[inner], atol=0.1)
    away = cv2.dilate(on.face, np.ones((9, 9), np.uint8)) == 0
    steps = np.abs(np.diff(whole, axis=1))[away[:, 1:] & away[:, :-1]]
    assert np.abs(whole)[away].max() < 1.01  # what lay beside the face is not taken
    assert steps.max() < 0.2 < np.abs(np.diff(sides[inner.any(1)], axis=1)).max()


def hard(azimuth_deg: float) -> EnvironmentMap:
    """Almost all light from one side."""
    dim = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.08))
    return dim.with_light(direction(azimuth_deg, 70.0), torch.full((3,), 3.0))


def varies(picture: np.ndarray) -> float:
    """How much skin's logarithm does."""
    return float(np.log(picture[on_skin()] @ LUMINANCE_ + 1e-3).std())


def test_shadows_that_the_picture_lacks_are_not_inverted() -> None:
    """A face in even light, for which a hard light was found, stays without shadows in even."""
    flat = image(even())
    picture, _ = portrait(hard(120.0), flat).under(even())
    wrong = image(even()) / np.maximum(image(hard(120.0)), 1e-3) * flat  # a ratio of shadings
    assert varies(picture) < varies(flat) + 0.1
    assert varies(wrong) > varies(flat) + 0.3


def test_shadows_that_the_picture_shows_are_taken_away() -> None:
    seen = image(hard(120.0))
    picture, _ = portrait(hard(120.0), seen).under(even())
    assert varies(picture) < 0.6 * varies(seen)


def test_gains_are_bounded_above_the_photograph_and_below_their_mean() -> None:
    black = EnvironmentMap(radiance=torch.full((64, 128, 3), 1e-4))
    lamp = black.with_light(direction(80.0, 80.0), torch.full((3,), 10.0))
    seen = image(even())
    one = portrait(even(), seen)
    picture, _ = one.under(lamp)
    gain = np.log((picture[on_skin()] @ LUMINANCE_) / (seen[on_skin()] @ LUMINANCE_))
    shading, specular = one.shaded_by(lamp)
    level = level_of(shading, one.bounced(shading), specular / one.albedo, one.on) - one.before
    mean = float(level[one.on.face > 0].mean())
    assert mean < -0.5
    assert gain.max() < BRIGHTER + 0.1  # and a change of colour
    assert gain.min() > mean - DARKER - 0.1
    assert np.ptp(gain) > 1  # and there is something to bound
    x = np.linspace(-0.1, 0.1, 5, dtype=np.float32)
    np.testing.assert_allclose(bounded(x), x, atol=1e-3)
    np.testing.assert_allclose(bounded(np.array([-90, 90], np.float32)), [-DARKER, BRIGHTER])


def test_grey_shadows_get_the_colour_of_skin_with_their_new_light() -> None:
    """A photograph has less colour in shadows; what is lit anew is as red as the rest."""
    old = hard(120.0)
    seen = image(old)
    dark = (seen @ LUMINANCE_ < 0.4 * np.median(seen[on_skin()] @ LUMINANCE_)) & on_skin()
    assert dark.sum() > 50
    seen[dark] = (seen[dark] @ LUMINANCE_)[:, None]

    def red(picture: np.ndarray) -> float:
        return float((picture[dark] / picture[dark].sum(-1, keepdims=True))[:, 0].mean())

    picture, _ = portrait(old, seen).under(even())
    same, _ = portrait(old, seen).under(old)
    assert red(seen) + 0.02 < red(picture) < red(image(old))
    assert red(same) == pytest.approx(red(seen), abs=1e-5)


def test_a_white_collar_is_not_taken_for_grey_skin() -> None:
    """On the neck of the model, where a photograph shows cloth: as bright as skin, and grey."""
    light = sunny(50.0, 45.0)
    neck = (region_image(person()) == Region.NECK).astype(np.uint8)
    collar = cv2.erode(neck, np.ones((5, 5), np.uint8)) > 0
    assert collar.sum() > 50
    seen = image(light)
    assert portrait(light, seen).colour.alike[collar].mean() > 0.8
    seen[neck > 0] = float(np.median(seen[on_skin()] @ LUMINANCE_))
    assert portrait(light, seen).colour.alike[collar].mean() < 0.2


def test_highlights_without_colour_get_that_of_skin_as_they_get_darker() -> None:
    """What is near white is grey where it is only made darker; by a bounded change, none unlit."""
    old = hard(120.0)
    seen = image(old)
    face = region_image(person()) == Region.FACE
    bright = (seen @ LUMINANCE_ > np.quantile(seen[face] @ LUMINANCE_, 0.85)) & face
    pale = seen.copy()
    pale[bright] = 0.8 * (pale[bright] + (pale[bright] @ LUMINANCE_)[:, None])  # and brighter
    one = portrait(old, pale)
    picture, _ = one.under(hard(-120.0), keep="place")

    def red(of: np.ndarray, over: int) -> float:
        return float(np.log(of[bright][:, 0] / of[bright][:, over]).mean())

    for over in (1, 2):  # green too: a highlight that loses blue alone turns yellow, then green
        lost = red(seen, over) - red(pale, over)
        assert lost > 0.15
        assert red(pale, over) + 0.85 * lost < red(picture, over) < red(seen, over) + 0.1
    assert np.abs(one.colour.lacks).max() <= HUE


def test_cloth_keeps_its_colour_where_the_place_stays() -> None:
    red = EnvironmentMap(radiance=even(0.3).radiance * torch.tensor([0.6, 1.0, 1.6]))
    light = red.with_light(direction(60.0, 60.0), torch.tensor([3.0, 2.0, 1.0]))
    one = portrait(light, image(light))
    picture, _ = one.under(sunny(-60.0, 60.0), keep="place")
    away = cv2.dilate(one.on.bare, np.ones((7, 7), np.uint8)) == 0
    cloth = (region_image(person()) == BUST) & away
    assert cloth.sum() > 10
    ratio = picture[cloth] / image(light)[cloth]
    np.testing.assert_allclose(ratio, ratio.mean(1, keepdims=True) * np.ones(3), rtol=1e-3)
    assert np.abs(np.log(ratio)).max() > 0.1


def test_a_key_light_leaves_what_is_black_and_what_is_white() -> None:
    """Clothes at the camera's black and at white, below a face that is lit from below."""
    old, new = even(0.4), sunny(180.0, 130.0)
    cloth = cv2.erode((region_image(person()) == BUST).astype(np.uint8), np.ones((3, 3))) > 0
    gains: list[np.ndarray] = []
    for level in (0.002, 0.1, 0.97):
        seen = image(old)
        seen[cloth] = level
        picture, _ = portrait(old, seen).under(new, keep="brightness")
        gains.append(picture[cloth] / level)
    assert gains[1].max() > 1.1
    assert gains[0].max() < 1 + 0.3 * (gains[1].max() - 1)
    assert gains[2].max() < 1.06


def test_what_cannot_be_relit_is_relit_weaker_and_said() -> None:
    light, other = sunny(40.0, 50.0), hard(-60.0)
    plain = of_the_model(light)
    assert (plain.strength, plain.doubts) == (1.0, ())
    white = portrait(light, np.minimum(8 * image(light), 1))
    assert any("over-exposed" in line for line in white.doubts)
    behind = portrait(hard(10.0), image(hard(10.0)))
    assert any("from behind" in line for line in behind.doubts)
    rng = np.random.default_rng(2)
    spots = cv2.GaussianBlur(rng.normal(size=on_skin().shape).astype(np.float32), (0, 0), 4.0)
    spotted = image(even()) * np.exp(0.4 * spots / spots.std())[..., None]
    strange = portrait(hard(120.0), spotted.astype(np.float32))
    assert any("not those" in line for line in strange.doubts)
    for one in (white, behind, strange):
        assert one.strength < 1
        weak, _ = one.under(other)
        full, _ = replace(one, strength=1.0).under(other)
        inner = on_skin()
        ratios = [np.log((x @ LUMINANCE_ + 1e-6) / (one.scene @ LUMINANCE_ + 1e-6))[inner]
                  for x in (weak, full)]  # fmt: skip
        assert ratios[0].std() < ratios[1].std()


def test_a_matte_is_soft_in_clothes_and_sharp_at_the_head_and_at_edges() -> None:
    cut = np.zeros((120, 120), np.float32)
    cut[:, :60] = 1
    head = np.zeros((60, 60), np.float32)
    head[:20] = 1
    grey = np.full((120, 120, 3), 0.5, np.float32)
    soft = soft_matte(grey, cut, head, 40.0)
    near = np.abs(np.arange(120) - 59.5) < 5
    np.testing.assert_allclose(soft[:20, ~near], cut[:20, ~near], atol=1e-3)
    assert np.abs(np.diff(soft[110])).max() < 0.2
    assert 0.1 < soft[110, 55] < 0.9
    edge = soft_matte(np.where(cut[..., None] > 0, grey, 0.1), cut, head, 40.0)
    assert np.abs(np.diff(edge[110])).max() > 0.8


def test_grey_pictures_stay_grey() -> None:
    old, new = sunny(50.0, 45.0), sunny(-60.0, 35.0)
    grey = np.repeat(image(old).mean(-1, keepdims=True), 3, 2)
    picture, _ = portrait(old, grey, grey=True).under(new)
    assert float(np.ptp(picture, axis=2).max()) < 1e-5


def test_a_face_all_under_hair_is_refused() -> None:
    light = sunny(40.0, 50.0)
    with pytest.raises(InputError, match="no skin"):
        portrait(light, image(light), hair=1.0)


def test_what_two_lights_share() -> None:
    left, right = sunny(-90.0, 45.0), sunny(90.0, 45.0)
    assert shared_light(left, EnvironmentMap(radiance=3 * left.radiance)) == pytest.approx(1.0)
    of_sky = 4 * math.pi * 0.4
    suns = float(torch.tensor([2.0, 1.8, 1.5]) @ torch.tensor([0.2126, 0.7152, 0.0722]))
    assert shared_light(left, right) == pytest.approx(1 - 2 * suns / (suns + of_sky), abs=1e-3)
    dark = EnvironmentMap(radiance=torch.zeros(64, 128, 3))
    points = [dark.with_light(direction(a, 45.0), torch.ones(3)) for a in (-90.0, 90.0)]
    assert shared_light(*points) == 0.0


def test_irradiance_of_upright_surfaces() -> None:
    # int sin^2 over the sphere = pi^2, over pi
    torch.testing.assert_close(
        upright_irradiance(even()), torch.full((3,), math.pi).double(), rtol=1e-3, atol=0
    )
    side = EnvironmentMap(radiance=torch.zeros(64, 128, 3)).with_light(
        direction(30.0, 60.0), torch.ones(3)
    )
    want = math.sin(math.radians(60)) / math.pi  # the mean of a cosine above 0 over a turn
    assert float(upright_irradiance(side)[0]) == pytest.approx(want, rel=1e-3)


def test_a_scaled_camera_shows_the_same_picture() -> None:
    camera = sunny_face(40.0, 50.0).truth.camera
    half = scaled(camera, 0.5)
    points = torch.tensor([[0.1, -0.05, -1.0], [-0.2, 0.1, -1.4]], dtype=torch.float64)
    across = torch.tensor([half.width / camera.width, half.height / camera.height])
    torch.testing.assert_close(
        half.project(points), camera.project(points) * across, rtol=1e-2, atol=0.2
    )


def test_an_edited_photograph_is_relit_as_the_scene_is_and_edited() -> None:
    found, other = sunny(-50.0, 40.0), sunny(30.0, 60.0)
    edit = Edit(saturation=1.3, contrast=1.15, pivot=0.3)
    seen = edit.apply(torch.from_numpy(image(found))).numpy()
    want, _ = of_the_model(found).under(other)
    picture, _ = portrait(found, seen, edit=edit).under(other)
    scene = edit.undo(torch.from_numpy(picture)).numpy()
    shows = on_skin() & (seen.min(2) > 1e-3)  # nothing that the edit made black
    assert np.abs(scene - want)[shows].mean() < 0.01 * want[shows].mean()
    same, _ = portrait(found, seen, edit=edit).under(found)
    np.testing.assert_allclose(same, seen, atol=1e-5)


def test_a_highlight_goes_with_its_light_and_with_no_other() -> None:
    """A spot of white on a cheek gets darker than skin beside it does, and stays as it is lit."""
    old = hard(120.0)
    seen = image(old)
    face = cv2.erode((region_image(person()) == Region.FACE).astype(np.uint8), np.ones((3, 3)))
    lit = (seen @ LUMINANCE_ > np.quantile(seen[on_skin()] @ LUMINANCE_, 0.85)) & (face > 0)
    glossy = seen.copy()
    glossy[lit] += 0.5 * glossy[lit].max(-1, keepdims=True)
    one = portrait(old, glossy)
    pale = one.colour.pale
    assert pale.max() <= 0
    without = portrait(old, seen).colour.pale
    assert pale[lit][:, 2].mean() < without[lit][:, 2].mean() - 0.05
    away = cv2.dilate(lit.astype(np.uint8), np.ones((5, 5))) == 0
    assert np.abs(pale[away]).max() < 0.5 * np.abs(pale).max()  # the model's own highlights
    flat = np.full(lit.shape, 1.0, np.float32)
    np.testing.assert_array_equal(one.colour.without_highlights(0 * flat), 0)
    np.testing.assert_array_equal(one.colour.without_highlights(flat), 0)
    np.testing.assert_allclose(one.colour.without_highlights(-99 * flat), pale, rtol=1e-5)


def near_white(exposure: np.ndarray, skin: np.ndarray, level: float | None) -> np.ndarray:
    """A ramp of skin as a camera clips it, made darker by a logarithm: (h,w,3)."""
    true = np.float32(exposure[None, :, None] * skin) * np.ones((60, 1, 1), np.float32)
    seen = np.minimum(true, 1)
    everywhere = np.ones(seen.shape[:2], np.float32)
    on = Surface(bare=everywhere, face=everywhere, traced=everywhere, face_px=60.0)
    base = base_of(seen, 1.0, 60.0)
    if level is None:
        return seen
    colour = SkinColour.of(seen, base, everywhere, on)
    return seen * np.exp(level + colour.out_of_white(np.full(base.shape, level, np.float32)))


@pytest.mark.parametrize("skin", [(0.5, 0.3, 0.2), (0.5, 0.35, 0.3), (0.4, 0.2, 0.1)])
def test_skin_out_of_white_keeps_its_hue_and_pales_evenly(skin: tuple[float, ...]) -> None:
    """Red ends at white first, so that only to make it darker turns skin yellow and then green."""
    albedo = np.array(skin, np.float32)
    exposure = np.linspace(0.5, 1.3, 200) / albedo[0] ** 0.5 / albedo[1] ** 0.5
    middle = np.s_[10:-10]

    def colours(picture: np.ndarray) -> np.ndarray:
        return colour_of(picture[30])[middle]

    usual = colours(near_white(exposure, albedo, None))[0]
    seen, relit = (colours(near_white(exposure, albedo, level)) for level in (None, -0.7))
    across = np.cross(usual, LUMINANCE_)
    across /= np.linalg.norm(across)
    assert np.abs(seen @ across).max() > 0.08  # what the camera did
    assert np.abs(relit @ across).max() < 0.5 * np.abs(seen @ across).max()
    chroma = relit @ usual / np.linalg.norm(usual)
    assert np.diff(chroma).max() < 2e-3
    assert np.all(relit[:, 0] >= relit[:, 1] - 0.01)  # never greener than it is red


def test_skin_below_white_and_a_light_that_stays_change_no_hue() -> None:
    albedo = np.array([0.5, 0.3, 0.2], np.float32)
    dim = np.linspace(0.2, 1.2, 100)
    for exposure, level in ((dim, -0.7), (2 * dim, 0.0), (2 * dim, 0.3)):
        relit, seen = (near_white(exposure, albedo, each) for each in (level, None))
        np.testing.assert_allclose(relit, seen * np.exp(level), rtol=1e-5)


def test_skin_comes_out_of_white_with_an_exposure_too() -> None:
    """Over-exposed skin is yellow: a picture that is made darker as a whole shows it."""
    light = sunny(40.0, 50.0)
    seen = np.minimum(image(light) * (1.6 / np.quantile(image(light)[on_skin()], 0.9)), 1)
    one = portrait(light, seen.astype(np.float32))
    one = replace(one, strength=1.0, doubts=())
    astray = np.abs(one.colour.astray) > 0.02
    assert astray.sum() > 20
    same, _ = one.under(light, keep="place")
    np.testing.assert_allclose(same, seen, atol=1e-5)
    dimmed, _ = one.under(light, 0.5, keep="place")
    usual = one.colour.across

    def off(picture: np.ndarray) -> float:
        return float(np.abs(colour_of(picture[astray]) @ usual).mean())

    assert off(dimmed) < 0.7 * off(seen)
    # and nothing else is but half as bright
    away = one.colour.astray == 0
    assert away.mean() > 0.5
    np.testing.assert_allclose(dimmed[away], 0.5 * seen[away], rtol=1e-4)


def test_lips_near_white_keep_their_hue() -> None:
    """They are no skin that has strayed, as they have not its colour."""
    everywhere = np.ones((60, 200), np.float32)
    exposure = np.linspace(1.4, 3.7, 200)[None, :, None]
    skin, lips = np.array([0.5, 0.3, 0.2]), np.array([0.5, 0.14, 0.16])
    is_lip = np.indices(everywhere.shape)[0] < 20
    seen = np.minimum(exposure * np.where(is_lip[..., None], lips, skin), 1).astype(np.float32)
    on = Surface(bare=everywhere, face=everywhere, traced=everywhere, face_px=60.0)
    colour = SkinColour.of(seen, base_of(seen, 1.0, 60.0), float32(~is_lip), on)
    assert np.abs(colour.astray[45]).max() > 0.05
    assert np.abs(colour.astray[8]).max() < 0.2 * np.abs(colour.astray[45]).max()
