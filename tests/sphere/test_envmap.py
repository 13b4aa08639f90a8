import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap, luminance, shift_columns
from skylight.sphere._frame import (
    DirectionGrid,
    angle_between,
    direction_from_angles,
    rotation_about,
)
from skylight.sphere._map_rotation import _evenly_fine

F64 = torch.float64
SUN_RADIUS_RAD = math.radians(0.2667)
SUN_SOLID_ANGLE = 6.807e-5  # sr, of a disc of that radius
UP = torch.tensor([0.0, 1.0, 0.0], dtype=F64)


def smooth(directions: torch.Tensor) -> torch.Tensor:
    """Positive radiance without any special direction, different in each colour."""
    x, y, z = directions.unbind(-1)
    return torch.stack([2 + x + 0.5 * y * z, 2 + y - 0.5 * x * z, 2 + z + 0.5 * x * y], -1)


def smooth_map(height: int, width: int | None = None) -> EnvironmentMap:
    grid = DirectionGrid.latlong(height, width)
    assert grid.layout is not None
    return EnvironmentMap(radiance=smooth(grid.directions).reshape(*grid.layout, 3))


def one_pixel(height: int, row: int, column: int) -> EnvironmentMap:
    radiance = torch.zeros(height, 2 * height, 3, dtype=F64)
    radiance[row, column] = 1.0
    return EnvironmentMap(radiance=radiance)


def test_luminance_of_white_is_one() -> None:
    assert luminance(torch.ones(3, dtype=F64)).item() == pytest.approx(1)
    assert luminance(torch.eye(3, dtype=F64)).tolist() == [0.2126, 0.7152, 0.0722]


def test_shapes_that_are_no_map_are_refused() -> None:
    with pytest.raises(InputError, match="12x4"):
        EnvironmentMap(radiance=torch.zeros(4, 12, 3))


@pytest.mark.parametrize("width", [128, 256])
def test_constant_light_integrates_and_lights_exactly(width: int) -> None:
    constant = EnvironmentMap(radiance=torch.full((64, width, 3), 2.0, dtype=F64))
    total = 4 * math.pi if width == 128 else 2 * math.pi
    assert constant.integrate().tolist() == pytest.approx([2 * total] * 3, rel=1e-12)
    assert constant.irradiance(UP).tolist() == pytest.approx([2 * math.pi] * 3, rel=1e-3)


def test_furnace_for_every_normal() -> None:
    constant = EnvironmentMap(radiance=torch.ones(64, 128, 3, dtype=F64))
    for normal in DirectionGrid.hammersley(50).directions:
        assert constant.irradiance(normal)[0].item() == pytest.approx(math.pi, rel=1e-3)


def test_mean_direction() -> None:
    radiance = torch.ones(64, 128, 3, dtype=F64)
    constant = EnvironmentMap(radiance=radiance)
    torch.testing.assert_close(constant.mean_direction(), UP, atol=1e-12, rtol=0)
    x = DirectionGrid.latlong(64).directions[:, 0]
    ramp = (1 + x)[:, None].expand(-1, 3).reshape(64, 128, 3)
    mean = EnvironmentMap(radiance=ramp).mean_direction(upper_only=False)
    torch.testing.assert_close(mean, torch.tensor([1.0, 0, 0], dtype=F64), atol=1e-12, rtol=0)


# --- azimuth


@given(st.floats(-20, 20))
def test_azimuth_rotation_keeps_every_rows_energy(angle: float) -> None:
    source = torch.rand(6, 12, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    turned = EnvironmentMap(radiance=source).rotate_azimuth(angle).radiance
    assert (turned >= 0).all()
    torch.testing.assert_close(turned.sum(1), source.sum(1), rtol=1e-12, atol=0)


@given(st.integers(-40, 40))
def test_whole_columns_are_a_roll(columns: int) -> None:
    source = torch.rand(2, 4, 8, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    angle = torch.full((2,), columns * 2 * math.pi / 8, dtype=F64)
    torch.testing.assert_close(
        shift_columns(source, angle), torch.roll(source, columns, 2), atol=1e-12, rtol=0
    )


def test_azimuth_rotation_moves_light_to_larger_azimuths() -> None:
    bright = one_pixel(16, 8, 16)
    turned = bright.rotate_azimuth(math.pi / 2).radiance[..., 0]
    assert divmod(int(turned.argmax()), 32) == (8, 24)


@settings(max_examples=30)
@given(st.floats(-7, 7))
def test_azimuth_rotation_of_smooth_content_has_no_seam(angle: float) -> None:
    """The turned map is the map of the turned function, at the seam as elsewhere."""
    source = smooth_map(32)
    turned = source.rotate_azimuth(angle).radiance
    # growing azimuth is a negative turn about +Y; L'(w) = L(R^T w)
    back = source.grid.directions @ rotation_about(UP, -angle)
    expected = smooth(back).reshape(32, 64, 3)
    torch.testing.assert_close(turned, expected, atol=3e-3, rtol=0)
    step = (turned[:, 0] - turned[:, -1]).abs().max()
    others = torch.diff(turned, dim=1).abs().max()
    assert step <= others + 1e-2


def test_azimuth_rotation_is_differentiable_in_both_arguments() -> None:
    images = torch.rand(2, 3, 8, 1, generator=torch.Generator().manual_seed(0), dtype=F64)
    angle = torch.tensor([0.3, -5.1], dtype=F64)
    assert torch.autograd.gradcheck(
        shift_columns, (images.requires_grad_(), angle.requires_grad_())
    )


# --- any rotation


def test_rotation_moves_light_where_the_matrix_says() -> None:
    source = smooth_map(64)
    turn = rotation_about(torch.tensor([1.0, 2.0, -0.5], dtype=F64), 1.1)
    expected = smooth(source.grid.directions @ turn).reshape(64, 128, 3)
    torch.testing.assert_close(source.rotate(turn).radiance, expected, atol=1e-2, rtol=0)


def test_rotations_compose_and_invert_on_maps() -> None:
    source = smooth_map(64)
    a = rotation_about(torch.tensor([1.0, 0.0, 0.0], dtype=F64), 0.7)
    b = rotation_about(torch.tensor([0.0, 0.6, 0.8], dtype=F64), -1.9)
    both, once = source.rotate(a).rotate(b), source.rotate(b @ a)
    torch.testing.assert_close(both.radiance, once.radiance, atol=1e-2, rtol=0)
    back = source.rotate(a).rotate(a.T)
    torch.testing.assert_close(back.radiance, source.radiance, atol=1e-2, rtol=0)


def test_rotation_about_up_agrees_with_the_azimuth_shift() -> None:
    source = smooth_map(64)
    turned = source.rotate(rotation_about(UP, -0.4)).radiance
    torch.testing.assert_close(turned, source.rotate_azimuth(0.4).radiance, atol=1e-2, rtol=0)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 1.0)])
def test_energy_error_of_a_rotation_is_bounded(axis: tuple[float, float, float]) -> None:
    for angle in (0.1, 0.5, 1.0, 2.0, 3.0):
        turn = rotation_about(torch.tensor(axis, dtype=F64), angle)
        before, after = smooth_map(32), smooth_map(32).rotate(turn)
        torch.testing.assert_close(after.integrate(), before.integrate(), rtol=1e-4, atol=0)
        for row, bound in {
            0: 0.13,
            1: 0.05,
            2: 0.02,
            6: 0.02,
            12: 0.02,
            16: 0.02,
            30: 0.05,
        }.items():
            spot = one_pixel(32, row, 11)
            ratio = spot.rotate(turn).integrate()[0] / spot.integrate()[0]
            assert 1 - bound < ratio < 1 + bound


def test_energy_error_of_a_rotated_room_is_small() -> None:
    """A lamp of 3.6 degrees, 1000 times as bright as the walls: half the light is its."""
    grid = DirectionGrid.latlong(128)
    for lamp, bound in ((UP, 2e-2), *((w, 1e-3) for w in DirectionGrid.hammersley(12).directions)):
        angle = angle_between(grid.directions, lamp.expand_as(grid.directions))
        light = 1 + 1000 * (angle < math.radians(1.8)).double()
        room = EnvironmentMap(radiance=light.reshape(128, 256, 1).expand(-1, -1, 3).contiguous())
        for axis, angle_rad in (((1.0, 0.0, 0.0), 0.5), ((1.0, 2.0, -0.5), 2.1)):
            turned = room.rotate(rotation_about(torch.tensor(axis, dtype=F64), angle_rad))
            assert (turned.integrate() / room.integrate() - 1).abs().max() < bound


def test_rotation_is_linear_and_keeps_a_constant() -> None:
    turn = rotation_about(torch.tensor([1.0, 1.0, 0.0], dtype=F64), 0.8)
    one, two = one_pixel(16, 1, 3), smooth_map(16)
    both = EnvironmentMap(radiance=one.radiance - 2 * two.radiance).rotate(turn).radiance
    apart = one.rotate(turn).radiance - 2 * two.rotate(turn).radiance
    torch.testing.assert_close(both, apart)
    assert (one.rotate(turn).radiance >= 0).all()
    constant = EnvironmentMap(radiance=torch.full((16, 32, 3), 3.0))
    torch.testing.assert_close(constant.rotate(turn).radiance, constant.radiance)


def test_rows_are_averaged_over_as_many_columns_as_pixels_are_high() -> None:
    """A single pixel becomes a box of 1 / sin(zenith) columns, of the same energy."""
    for row in (0, 1, 3, 7, 15):
        spot = one_pixel(32, row, 11).radiance.permute(2, 0, 1)
        box = _evenly_fine(spot)[0, row]
        width = 1 / math.sin((row + 0.5) * math.pi / 32)
        torch.testing.assert_close(box.sum(), torch.tensor(1.0, dtype=F64))
        assert box.max().item() == pytest.approx(1 / width)
        offset = torch.arange(64, dtype=F64) - 11
        offset = (offset + 32) % 64 - 32
        expected = (width / 2 + 0.5 - offset.abs()).clamp(0, 1) / width
        torch.testing.assert_close(box, expected)


def test_rotation_has_gradients() -> None:
    turn = rotation_about(torch.tensor([1.0, 0.5, 0.0], dtype=F64), 0.8)
    light = torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    assert torch.autograd.gradcheck(
        lambda r: EnvironmentMap(radiance=r).rotate(turn).radiance, light.requires_grad_()
    )


def test_a_sky_cannot_be_turned_over() -> None:
    with pytest.raises(ValueError, match="full lat-long"):
        smooth_map(8, 32).rotate(torch.eye(3, dtype=F64))


# --- sizes and halves


@pytest.mark.parametrize(("azimuth", "zenith_deg"), [(0.0, 45.0), (3.141, 80.0), (-1.0, 3.0)])
def test_a_sun_keeps_its_energy_when_resized(azimuth: float, zenith_deg: float) -> None:
    """A 6.8e-5 sr sun, 1024x2048 -> 32x64: the energy, not the peak, must survive."""
    grid = DirectionGrid.latlong(1024)
    sun = direction_from_angles(
        torch.tensor(azimuth, dtype=F64), torch.tensor(math.radians(zenith_deg), dtype=F64)
    )
    inside = angle_between(grid.directions, sun.expand_as(grid.directions)) < SUN_RADIUS_RAD
    # a disc of 3 pixels' width is a ragged one: give it the energy of the real disc at 1e5
    inside_value = 1e5 * SUN_SOLID_ANGLE / (inside * grid.solid_angles).sum()
    radiance = torch.where(inside, inside_value, 1.0)[:, None].expand(-1, 3)
    source = EnvironmentMap(radiance=radiance.reshape(1024, 2048, 3).float())
    energy = 4 * math.pi + (1e5 - 1) * SUN_SOLID_ANGLE
    assert source.integrate()[0].item() == pytest.approx(energy, rel=1e-4)
    small = source.resize(32)
    assert small.layout == (32, 64)
    torch.testing.assert_close(small.integrate(), source.integrate(), rtol=1e-5, atol=0)
    assert small.radiance.min() >= 0.999


def test_resizing_is_exact_in_float64_and_keeps_constants() -> None:
    source = EnvironmentMap(
        radiance=torch.rand(30, 60, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    )
    for height in (7, 15, 30, 64):
        resized = source.resize(height)
        torch.testing.assert_close(resized.integrate(), source.integrate(), rtol=1e-12, atol=0)
        constant = EnvironmentMap(radiance=torch.full((30, 60, 3), 3.0)).resize(height)
        torch.testing.assert_close(constant.radiance, torch.full((height, 2 * height, 3), 3.0))
    torch.testing.assert_close(source.resize(30).radiance, source.radiance)


def test_halving_is_the_average_of_fours() -> None:
    source = smooth_map(16)
    weight = source.grid.solid_angles.reshape(16, 32, 1)
    fours = (source.radiance * weight).reshape(8, 2, 16, 2, 3).sum((1, 3))
    total = weight.reshape(8, 2, 16, 2, 1).sum((1, 3))
    torch.testing.assert_close(source.resize(8).radiance, fours / total)


def test_resizing_a_sky_is_resizing_the_upper_half() -> None:
    source = smooth_map(32)
    torch.testing.assert_close(
        source.upper().resize(4).radiance, source.resize(8).radiance[:4], atol=1e-12, rtol=0
    )


def test_upper_and_ground() -> None:
    full = smooth_map(8)
    sky = full.upper()
    assert sky.is_sky
    assert sky.upper() is sky
    ground = torch.tensor([0.1, 0.2, 0.3])
    whole = sky.with_ground(ground)
    assert whole.layout == (8, 16)
    assert torch.equal(whole.radiance[:4], full.radiance[:4])
    torch.testing.assert_close(whole.radiance[4:], ground.double().expand(4, 16, 3))


# --- the brightest direction


@settings(max_examples=40)
@given(st.floats(-math.pi, math.pi), st.floats(0.1, 1.4))
def test_brightest_direction_is_better_than_a_pixel(azimuth: float, zenith: float) -> None:
    """A sun of 6 pixels' blur under a bright sky, on 2.8-degree pixels."""
    grid = DirectionGrid.latlong(64)
    sun = direction_from_angles(torch.tensor(azimuth, dtype=F64), torch.tensor(zenith, dtype=F64))
    lobe = 1000 * torch.exp(1500 * (grid.directions @ sun - 1))
    radiance = (lobe + 1 + grid.directions[:, 1])[:, None].expand(-1, 3).reshape(64, 128, 3)
    found = EnvironmentMap(radiance=radiance).brightest_direction()
    assert math.degrees(angle_between(found, sun).item()) < 1.0


@settings(max_examples=5)
@given(st.floats(-math.pi, math.pi), st.floats(0.1, 1.4))
def test_brightest_direction_of_a_box_filtered_disc(azimuth: float, zenith: float) -> None:
    sun = direction_from_angles(torch.tensor(azimuth, dtype=F64), torch.tensor(zenith, dtype=F64))
    fine = DirectionGrid.latlong(512)
    inside = angle_between(fine.directions, sun.expand_as(fine.directions)) < 2 * SUN_RADIUS_RAD
    radiance = (1 + 1e4 * inside.double())[:, None].expand(-1, 3).reshape(512, 1024, 3)
    found = EnvironmentMap(radiance=radiance).resize(64).brightest_direction()
    # half the diagonal of a pixel is 2 degrees; a disc inside one pixel cannot be told from its
    # centre
    assert math.degrees(angle_between(found, sun).item()) < 2.0


def test_brightest_direction_ignores_the_ground() -> None:
    radiance = torch.ones(64, 128, 3)
    radiance[50, 3] = 1e6
    radiance[20, 100] = 10.0
    found = EnvironmentMap(radiance=radiance).brightest_direction()
    expected = DirectionGrid.latlong(64).directions[20 * 128 + 100]
    assert math.degrees(angle_between(found, expected).item()) < 1e-6


def test_brightest_direction_of_constant_light_is_a_direction() -> None:
    found = EnvironmentMap(radiance=torch.ones(16, 32, 3)).brightest_direction()
    assert found.norm().item() == pytest.approx(1)
    assert found[1] > 0


def test_a_distant_light_keeps_its_irradiance_and_needs_the_whole_sphere() -> None:
    towards, irradiance = torch.tensor([0.6, -0.48, 0.64], dtype=F64), torch.tensor([2.0, 1.0, 0.5])
    even = smooth_map(32)
    added = even.with_light(towards, irradiance)
    gained = added.irradiance(towards) - even.irradiance(towards)
    torch.testing.assert_close(gained.double(), irradiance.double(), rtol=2e-3, atol=0)
    with pytest.raises(ValueError, match="give it a ground"):
        even.upper().with_light(UP, irradiance)
