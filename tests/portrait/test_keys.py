"""Key lights: where they stand, how bright and wide they are, which side they light."""

import dataclasses
import math
from functools import lru_cache

import numpy as np
import pytest
import torch

from skylight._names import KeyName
from skylight.errors import InputError
from skylight.estimation._kept import KeptFace
from skylight.inverse._result import Lamp
from skylight.portrait._edge import WIDTH, leaning
from skylight.portrait._keys import (
    HARD_DEG,
    KEY_OVER_FILL,
    KEYS,
    SOFT_DEG,
    USUAL_DEG,
    ball_weights,
    brightness_of_ball,
    direction_seen,
    fill_of,
    key_light,
)
from skylight.portrait._relit import Portrait, light_in_photo, portrait_of, shared_light
from skylight.sphere._envmap import EnvironmentMap, luminance
from tests.sunny_face import direction, known_face

SKY = torch.tensor([0.1, 0.2, 0.4])


def with_light(environment: EnvironmentMap, *lamps: Lamp) -> KeptFace:
    """The known face, were this its light."""
    return dataclasses.replace(known_face(), environment=environment, lamps=lamps)


def even(rows: int = 64) -> EnvironmentMap:
    return EnvironmentMap(radiance=SKY.expand(rows, 2 * rows, 3).clone())


def test_angles_are_those_of_who_looks_at_the_picture() -> None:
    for place, want in (
        ((0.0, 0.0), (0, 0, 1)),  # the camera is behind -Z
        ((90.0, 0.0), (1, 0, 0)),  # the picture's right
        ((-90.0, 0.0), (-1, 0, 0)),
        ((180.0, 0.0), (0, 0, -1)),
        ((37.0, 90.0), (0, 1, 0)),
        ((0.0, -90.0), (0, -1, 0)),
    ):
        torch.testing.assert_close(
            direction_seen(*place), torch.tensor(want, dtype=torch.float64), rtol=0, atol=1e-12
        )
    x, y, z = zip(*(direction_seen(*KEYS[name]).tolist() for name in KEYS), strict=True)
    sides = dict(zip(KEYS, x, strict=True))
    assert sides["left"] < -0.5
    assert sides["right"] == pytest.approx(-sides["left"])
    assert max(KEYS, key=dict(zip(KEYS, y, strict=True)).__getitem__) == "top"
    assert [name for name, depth in zip(KEYS, z, strict=True) if depth < 0] == ["rim"]


def test_a_ball_is_lit_as_lambert_has_it() -> None:
    """Against the mean over a million places of its disc, in float64."""
    across = np.linspace(-1, 1, 1001)
    x, y = np.meshgrid(across, across)
    inside = x**2 + y**2 < 1
    normals = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1)[inside]
    for name in (*KEYS, (180.0, 0.0), (90.0, 0.0)):
        towards = direction_seen(*(KEYS[name] if isinstance(name, str) else name))
        want = np.maximum(normals @ towards.numpy(), 0).mean()
        assert float(ball_weights(towards)) == pytest.approx(want, abs=1e-3)


@pytest.mark.parametrize("strength", [0.0, 1.0, KEY_OVER_FILL, 50.0])
def test_brightness_stays_and_the_key_is_so_much_brighter_than_the_fill(strength: float) -> None:
    lit = even().with_light(direction(40.0, 50.0), torch.tensor([2.0, 1.8, 1.5]))
    found = with_light(lit)
    light = key_light(found, "left", strength=strength, size_deg=HARD_DEG).environment
    whole = brightness_of_ball(light_in_photo(found))
    assert brightness_of_ball(light) == pytest.approx(whole, rel=5e-3)
    # what faces the key receives it beside what the fill sends there
    fill = fill_of(light_in_photo(found))
    share = whole / brightness_of_ball(fill) / (1 + strength * float(ball_weights(metered())))
    towards = metered().float()
    key = luminance(light.irradiance(towards)) - share * luminance(fill.irradiance(towards))
    want = strength * share * brightness_of_ball(fill)
    assert float(key) == pytest.approx(want, rel=5e-3, abs=1e-3 * whole)


def metered() -> torch.Tensor:
    return direction_seen(*KEYS["left"])


def test_a_person_stays_as_bright_wherever_the_key_stands() -> None:
    found = with_light(even())
    received = {
        name: float(
            luminance(
                key_light(found, name).environment.irradiance(direction_seen(*KEYS[name]).float())
            )
        )
        for name in KEYS
    }
    assert received["left"] > received["top"] > received["front"]
    assert received["left"] == pytest.approx(received["right"], rel=1e-6)
    whole = brightness_of_ball(light_in_photo(found))
    for name in KEYS:
        ball = brightness_of_ball(key_light(found, name).environment)
        if name == "rim":
            assert ball == pytest.approx(0.726 * whole, rel=0.02)  # half a stop darker
        else:
            assert ball == pytest.approx(whole, rel=0.01)


def test_a_key_behind_the_sitter_is_an_edge_and_none_before() -> None:
    """From one to the other without a jump; of the light found is left what it was, dimmed."""
    lit = even().with_light(direction(40.0, 50.0), torch.tensor([2.0, 1.8, 1.5]))
    found = with_light(lit)
    lights = [key_light(found, (azimuth, 10.0)) for azimuth in np.arange(80.0, 151.0, 1.0)]
    edges = [light.edge.strength if light.edge else 0.0 for light in lights]
    assert edges[0] == 0 < edges[-1]
    assert np.all(np.diff(edges) >= -0.01)
    assert np.abs(np.diff(edges)).max() < 0.1 * max(edges)
    rim = key_light(found, "rim").environment
    assert shared_light(light_in_photo(found), rim) > 0.999


@pytest.mark.parametrize("size_deg", [HARD_DEG, USUAL_DEG, SOFT_DEG, 80.0])
def test_the_edge_is_lit_as_a_cylinder_is(size_deg: float) -> None:
    """One as thick as twice the band's width, by Lambert's law under a disc of that diameter."""
    face_px, rows = 400.0, 300
    radius = round(WIDTH * face_px)
    places = (np.arange(rows) + 0.5 - rows / 2) / radius  # from the cylinder's axis
    matte = np.repeat((np.abs(places) < 1)[None], rows, 0).astype(np.float32)
    leans = leaning(matte, face_px)
    edge = key_light(with_light(even()), (150.0, 0.0), size_deg=size_deg).edge
    assert edge is not None
    lit = edge.on(leans)[rows // 2]
    normals = np.stack([places, np.sqrt(np.maximum(1 - places**2, 0))], 1)
    want, half = np.zeros(rows), math.radians(size_deg) / 2
    # slices of the disc across the cylinder's axis, each as bright as it is long
    turns = np.linspace(-half, half, 201)[1:-1]
    shares = np.sqrt(half**2 - turns**2)
    for turn, share in zip(turns, shares / shares.sum(), strict=True):
        angle = math.radians(150.0) + turn
        want += share * np.maximum(normals @ [math.sin(angle), math.cos(angle)], 0)
    shown = np.abs(places) < 1
    np.testing.assert_allclose(lit[shown], want[shown], atol=0.05 + 0.04 * half)
    assert lit[shown][-1] > 0.3
    assert lit[shown][:radius].max() < 0.01 + 0.3 * max(half - math.radians(30), 0)
    # the border of the picture is no outline
    cut = leaning(matte[:, : rows // 2], face_px)
    assert np.abs(cut[rows // 2, -3:]).max() < 0.1


def test_gaps_between_locks_are_no_outline() -> None:
    matte = np.zeros((200, 200), np.float32)
    matte[:, :150] = 1
    whole = leaning(matte, 100.0)
    matte[90:96, 60:66] = 0
    np.testing.assert_allclose(leaning(matte, 100.0), whole, atol=1e-6)
    matte[60:120, 40:90] = 0  # under an arm
    assert np.abs(leaning(matte, 100.0) - whole).max() > 0.5


@pytest.mark.parametrize("size_deg", [HARD_DEG, USUAL_DEG, SOFT_DEG])
def test_a_key_is_as_wide_as_a_disc_of_that_diameter(size_deg: float) -> None:
    """By the mean square of the angle to its middle: a^2 / 2 of a small disc of radius a."""
    light = key_light(with_light(even(256)), "front", size_deg=size_deg, strength=1000.0)
    grid, middle = light.environment.grid, direction_seen(*KEYS["front"])
    lobe = luminance(light.environment.flat).double()
    lobe = (lobe - lobe.min()) * grid.solid_angles
    chords = (grid.directions - middle).square().sum(1)
    radius = math.degrees(math.sqrt(2 * float(lobe @ chords / lobe.sum())))
    assert radius == pytest.approx(size_deg / 2, rel=0.02)


def test_the_fill_is_even_and_of_the_colour_of_all_light() -> None:
    sun = torch.tensor([2.0, 1.8, 1.5])
    found = with_light(even().with_light(direction(40.0, 50.0), sun))
    fill = fill_of(light_in_photo(found))
    torch.testing.assert_close(fill.flat, fill.flat[:1].expand(fill.flat.shape))
    torch.testing.assert_close(
        fill.integrate(), light_in_photo(found).integrate(), rtol=1e-4, atol=0
    )


@lru_cache(maxsize=1)
def portrait() -> Portrait:
    face = known_face()
    return portrait_of(face.photo, face.fit, face.reflection, light_in_photo(face), face_px=32)


@pytest.mark.parametrize("key", [*KEYS, (-80.0, 0.0), (80.0, 0.0), (0.0, -60.0)])
def test_a_key_lights_the_side_of_the_picture_that_it_is_named_by(
    key: KeyName | tuple[float, float],
) -> None:
    """Mean shading of skin left and right, above and below the middle of the face."""
    face = portrait()
    lit = key_light(known_face(), key)
    shading, _ = face.shaded_by(lit.environment)
    rows, columns = np.nonzero(face.on.bare)
    bright = shading.mean(2)[rows, columns]
    right = np.average(columns, weights=bright) - columns.mean()
    below = np.average(rows, weights=bright) - rows.mean()
    width = np.ptp(columns)
    if key in ("left", (-80.0, 0.0)):
        assert right < -0.05 * width
    elif key in ("right", (80.0, 0.0)):
        assert right > 0.05 * width
    elif key == "front":
        assert abs(right) < 0.05 * width
    elif key == "rim":
        assert lit.edge is not None
        sent = lit.edge.on(face.outline.leaning)
        assert np.average(np.indices(sent.shape)[1], weights=sent) > columns.mean()
        assert sent[face.on.face > 0].mean() < 0.1 * sent.max()
    else:
        assert below < 0 if key == "top" else below > 0


@pytest.mark.parametrize(
    ("place", "options", "said"),
    [
        ((math.nan, 0.0), {}, "azimuth"),
        ((400.0, 0.0), {}, "azimuth"),
        ((0.0, 91.0), {}, "elevation"),
        ((0.0, 0.0), {"size_deg": 0.5}, "wide"),
        ((0.0, 0.0), {"size_deg": math.nan}, "wide"),
        ((0.0, 0.0), {"strength": -1.0}, "strength"),
        ((0.0, 0.0), {"strength": math.inf}, "strength"),
    ],
)
def test_keys_that_cannot_be(
    place: tuple[float, float], options: dict[str, float], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        key_light(known_face(), place, **options)
