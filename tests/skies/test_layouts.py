import math
from pathlib import Path

import numpy as np
import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._hdr import write_exr
from skylight.skies import _layouts
from skylight.skies._layouts import Layout, pixel_solid_angles, read_pixels, read_sky, sky_of
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import (
    DirectionGrid,
    angle_between,
    angles_from_direction,
    direction_from_angles,
)

# (place in the square: to the right, up; azimuth in degrees) as the layouts are documented
COMPASS = {
    "angular": [(0, -1, 0), (1, 0, 90), (0, 1, 180), (-1, 0, -90)],
    "fisheye": [(0, 1, 0), (-1, 0, 90), (0, -1, 180), (1, 0, -90)],
}


def write(path: Path, radiance: Float[Tensor, "h w 3"]) -> Path:
    write_exr(path, radiance.numpy().astype(np.float32), half=False, header={})
    return path


def paint(
    layout: Layout, size: int, field_deg: float, azimuth: float, zenith: float, width_rad: float
) -> Float[Tensor, "n n 3"]:
    """A square map of a round lamp, from the compass and the definition of the projection."""
    centre = (torch.arange(size, dtype=torch.float64) + 0.5) * 2 / size - 1
    right, up = centre[None], -centre[:, None]
    ahead, beside = COMPASS[layout][0], COMPASS[layout][1]
    north = ahead[0] * right + ahead[1] * up
    east = beside[0] * right + beside[1] * up
    distance = torch.hypot(north, east)
    directions = direction_from_angles(
        torch.atan2(east, north), distance * math.radians(field_deg) / 2
    )
    lamp = direction_from_angles(torch.tensor(azimuth), torch.tensor(zenith)).double()
    angle = angle_between(directions, lamp.expand_as(directions))
    light = 0.5 + 1000 * torch.exp(-((angle / width_rad) ** 2))
    return torch.where(distance <= 1, light, 0.0)[..., None].expand(-1, -1, 3).float().contiguous()


@pytest.mark.parametrize("layout", ["angular", "fisheye"])
@pytest.mark.parametrize("field_deg", [180.0, 220.0])
def test_squares_look_where_they_are_documented_to(layout: Layout, field_deg: float) -> None:
    for right, up, azimuth_deg in COMPASS[layout]:
        pixels = torch.zeros(128, 128, 3)
        edge = 60.0 / (field_deg / 2) * 64  # 60 degrees from the zenith
        pixels[int(64 - up * edge), int(64 + right * edge)] = 1.0
        sun = sky_of(pixels, layout, field_deg=field_deg).brightest_direction()
        azimuth, zenith = angles_from_direction(sun)
        assert math.degrees(float(zenith)) == pytest.approx(60, abs=2)
        turn = (math.degrees(float(azimuth)) - azimuth_deg + 180) % 360 - 180
        assert turn == pytest.approx(0, abs=2)


@pytest.mark.parametrize(("layout", "size"), [("angular", 129), ("fisheye", 160), ("angular", 300)])
def test_lamps_keep_their_place_and_energy(
    layout: Layout, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A round lamp against the same lamp painted on a fine lat-long map.

    The largest square is averaged down first.
    """
    monkeypatch.setattr(_layouts, "_LARGEST", 256)
    grid = DirectionGrid.sky(180)
    for azimuth, zenith in ((0.3, 0.04), (-2.0, 0.7), (3.0, 1.3)):
        lamp = direction_from_angles(torch.tensor(azimuth), torch.tensor(zenith)).double()
        angle = angle_between(grid.directions, lamp.expand_as(grid.directions))
        light = (0.5 + 1000 * torch.exp(-((angle / 0.06) ** 2))).float()
        truth = EnvironmentMap(radiance=light.reshape(180, 720, 1).expand(-1, -1, 3))
        found = sky_of(paint(layout, size, 180.0, azimuth, zenith, 0.06), layout)
        torch.testing.assert_close(found.integrate(), truth.integrate(), rtol=0.01, atol=0)
        sun = found.brightest_direction()
        assert float(angle_between(sun, lamp).rad2deg()) < 0.8


# the smallest square's horizon is ragged: one pixel is 3 degrees there
@pytest.mark.parametrize(("size", "evenness"), [(64, 0.08), (200, 0.02)])
def test_single_pixels_keep_their_energy_and_even_light_stays_even(
    size: int, evenness: float
) -> None:
    solid = pixel_solid_angles(size, 180.0)
    assert float(solid.sum()) == pytest.approx(2 * math.pi)
    # L = 1 / solid angle in one pixel integrates to 1, wherever it is
    rng = np.random.default_rng(size)
    for row, column in [(size // 2, size // 2), *rng.integers(size // 5, 4 * size // 5, (8, 2))]:
        pixels = torch.zeros(size, size, 3)
        pixels[row, column] = 1 / float(solid[row, column])
        torch.testing.assert_close(sky_of(pixels, "angular").integrate(), torch.ones(3))
    even = sky_of(torch.ones(size, size, 3), "angular").radiance
    torch.testing.assert_close(even, torch.ones_like(even), rtol=evenness, atol=0)


def test_the_solid_angle_of_a_pixel() -> None:
    """In the middle and half way out: (field / 2)^2 sin(t) / t of its area, by calculus."""
    solid = pixel_solid_angles(400, 200.0)
    scale = math.radians(100)
    assert float(solid[200, 200]) == pytest.approx((scale / 200) ** 2, rel=1e-3)
    t = scale * math.hypot(0.5 / 200, 100.5 / 200)
    assert float(solid[200, 300]) == pytest.approx((scale / 200) ** 2 * math.sin(t) / t, rel=1e-3)
    assert float(solid[200, 399]) == 0  # 99.75 degrees from the zenith


def test_reading_each_layout(tmp_path: Path) -> None:
    sky = torch.rand(8, 32, 3) + 1
    full = write(tmp_path / "full.exr", torch.cat([sky, -torch.ones(8, 32, 3)]))
    upper = write(tmp_path / "upper.exr", sky)
    square = write(tmp_path / "square.exr", torch.ones(64, 64, 3))
    assert read_pixels(full)[0] == "latlong"
    assert torch.equal(read_sky(full, "latlong").radiance, sky)  # what is below does not count
    assert torch.equal(read_sky(upper, "skylatlong").radiance, sky)
    assert read_pixels(square)[0] == "angular"
    assert read_pixels(square, "fisheye")[0] == "fisheye"
    corner = torch.ones(64, 64, 3)
    corner[0, 0] = math.nan  # outside the circle
    assert read_sky(write(tmp_path / "corner.exr", corner), "angular").radiance.isfinite().all()


@pytest.mark.parametrize(
    ("shape", "layout", "field_deg", "value", "message"),
    [
        ((8, 20), None, 180.0, 1.0, "20x8 .* no shape of a sky"),
        ((8, 32), "latlong", 180.0, 1.0, "not the shape .* layout latlong, but skylatlong"),
        ((16, 32), "fisheye", 180.0, 1.0, "layout fisheye, but latlong"),
        ((8, 8), "latlong", 180.0, 1.0, "layout latlong, but angular"),
        ((8, 8), "angular", 120.0, 1.0, "a sky needs 180 to 360"),
        ((8, 8), "angular", 180.0, math.nan, "got 1 NaN, infinite or negative .* row 4, column 4"),
        ((8, 32), None, 180.0, math.inf, "row 4, column 4"),
        ((16, 32), None, 180.0, -1.0, "row 4, column 4"),
    ],
)
def test_what_is_no_sky(
    tmp_path: Path,
    shape: tuple[int, int],
    layout: Layout | None,
    field_deg: float,
    value: float,
    message: str,
) -> None:
    pixels = torch.ones(*shape, 3)
    pixels[4, 4] = value
    path = write(tmp_path / "a.exr", pixels)
    with pytest.raises(InputError, match=message):
        read_pixels(path, layout, field_deg=field_deg)
