"""New light for a portrait."""

import dataclasses
import math
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.inverse._lamp_relighting import LampLight
from skylight.inverse._result import Estimate, Lamp
from skylight.io._files import write_environment_map
from skylight.models._lamps import AMBIENT_PARAMETERS, LampsLight
from skylight.portrait._lights import ADDED_SUN, light_of_map, light_with_sun_at, rotated_light
from skylight.portrait._relit import light_in_photo
from skylight.relight._lamps import split_main_light
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angle_between
from tests.sunny_face import direction, sunny_estimate


def with_map(environment: EnvironmentMap) -> Estimate:
    return dataclasses.replace(sunny_estimate().estimate, environment=environment)


def sunny() -> EnvironmentMap:
    even = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.2))
    return even.with_light(direction(40.0, 50.0), torch.tensor([2.0, 1.8, 1.5]))


def test_the_light_found_is_in_the_colours_of_the_photograph() -> None:
    estimate = sunny_estimate().estimate
    gains = torch.tensor([2.0, 1.0, 0.5])
    face = dataclasses.replace(estimate.faces[0], white_balance=gains)
    estimate = dataclasses.replace(estimate, faces=(face,))
    torch.testing.assert_close(
        light_in_photo(estimate).radiance,
        estimate.environment.radiance * gains,
    )


def test_a_rotated_light() -> None:
    light = rotated_light(with_map(sunny()), 70.0).environment
    sun = light.brightest_direction()
    assert math.degrees(angle_between(sun, direction(110.0, 50.0))) < 1.5


def test_a_moved_sun_keeps_its_irradiance_and_the_rest_of_the_light() -> None:
    estimate = with_map(sunny())
    light = light_with_sun_at(estimate, -60.0, 30.0).environment
    main, rest = split_main_light(light_in_photo(estimate))
    moved, same = split_main_light(light)
    assert math.degrees(angle_between(moved.direction, direction(-60.0, 60.0))) < 0.5
    torch.testing.assert_close(moved.irradiance, main.irradiance, rtol=0.01, atol=0)
    torch.testing.assert_close(same.radiance, rest.radiance, rtol=1e-3, atol=1e-4)
    assert light_with_sun_at(estimate, -60.0, 30.0).notes == ()


def test_a_sun_of_given_strength_and_one_that_was_not_there() -> None:
    even = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.2))
    flat = float(luminance(even.irradiance(torch.tensor([0.0, 1.0, 0.0]))))
    added = light_with_sun_at(with_map(even), 10.0, 45.0)
    assert "no sun was found" in added.notes[0]
    gains = float(luminance(sunny_estimate().estimate.white_balance))
    for light, times in (
        (added, ADDED_SUN),
        (light_with_sun_at(with_map(even), 10.0, 45.0, strength=2.0), 2.0),
        (light_with_sun_at(with_map(sunny()), 10.0, 45.0, strength=2.0), 2.0),
    ):
        main, _ = split_main_light(light.environment)
        want = times * flat * gains
        assert float(luminance(main.irradiance)) == pytest.approx(want, rel=0.08)


def test_a_lamp_moved_to_where_it_is_gives_the_light_found() -> None:
    lamp = Lamp(
        direction=direction(30.0, 60.0),
        irradiance=torch.tensor([1.0, 0.8, 0.6]),
        spread_rad=math.radians(20),
    )
    ambient = {64: LampsLight(0, 64).ambient(torch.zeros(AMBIENT_PARAMETERS))}
    face = dataclasses.replace(sunny_estimate().estimate.faces[0], exposure=0.2)
    estimate = dataclasses.replace(
        sunny_estimate().estimate, light="lamps", lamps=(lamp,), faces=(face,)
    )
    whole = LampLight(ambient=ambient, level=0.2, lamps=(lamp,)).environment(64)
    estimate = dataclasses.replace(estimate, environment=whole)
    again = light_with_sun_at(estimate, 30.0, 30.0).environment
    torch.testing.assert_close(
        again.radiance, light_in_photo(estimate).radiance, rtol=1e-4, atol=1e-6
    )


@pytest.mark.parametrize(
    ("elevation", "strength", "said"),
    [
        (-5.0, None, "has set"),
        (0.0, None, "has set"),
        (95.0, None, "between"),
        (30.0, -1.0, "0 or"),
    ],
)
def test_suns_that_cannot_be(elevation: float, strength: float | None, said: str) -> None:
    with pytest.raises(InputError, match=said):
        light_with_sun_at(with_map(sunny()), 0.0, elevation, strength)


def test_maps_are_read_and_refused(tmp_path: Path) -> None:
    full, sky, black, below = (tmp_path / f"{name}.exr" for name in ("a", "b", "c", "d"))
    write_environment_map(full, sunny())
    write_environment_map(sky, EnvironmentMap(radiance=torch.ones(16, 64, 3)))
    write_environment_map(black, EnvironmentMap(radiance=torch.zeros(32, 64, 3)))
    lower = torch.zeros(32, 64, 3)
    lower[20:] = 1
    write_environment_map(below, EnvironmentMap(radiance=lower))
    assert light_of_map(full).environment.layout == (64, 128)
    assert "from below" in light_of_map(below).notes[0]
    small = tmp_path / "e.exr"
    write_environment_map(small, EnvironmentMap(radiance=torch.ones(16, 32, 3)))
    odd = tmp_path / "f.exr"
    write_environment_map(odd, EnvironmentMap(radiance=torch.ones(33, 66, 3)))
    assert light_of_map(odd).notes == ()
    for path, said in (
        (sky, "lower half"),
        (black, "black"),
        (small, "too few"),
        (tmp_path / "none.exr", "none.exr"),
    ):
        with pytest.raises(InputError, match=said):
            light_of_map(path)
