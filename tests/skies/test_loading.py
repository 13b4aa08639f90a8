import math
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.skies._index import SkyRecord, centre_column_azimuth, load_skies, normalise
from skylight.skies._layouts import Layout
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles


def record(file: str, azimuth_rad: float = 0.0, layout: Layout = "latlong") -> SkyRecord:
    return SkyRecord(
        file=file,
        day="d",
        time="",
        regime="clear",
        sun_zenith_deg=50.0,
        map_azimuth_deg=math.degrees(azimuth_rad),
        sun_transmittance=1.0,
        layout=layout,
    )


def test_loaded_skies_face_the_sun_and_have_mean_one(tmp_path: Path) -> None:
    """A full map with a sun anywhere becomes a sky of the right size with it in column w/2."""
    grid = DirectionGrid.latlong(64)
    records = []
    for i, azimuth in enumerate((-2.5, -0.3, 1.234, 3.1)):
        sun = direction_from_angles(torch.tensor(azimuth), torch.tensor(0.9)).double()
        angle = angle_between(grid.directions, sun.expand_as(grid.directions))
        light = 0.3 + 500 * torch.exp(-((angle / 0.08) ** 2))
        light[grid.directions[:, 1] < 0] = 7.0  # the ground must not count
        radiance = light.float().reshape(64, 128, 1).expand(-1, -1, 3).contiguous()
        write_environment_map(tmp_path / f"{i}.exr", EnvironmentMap(radiance=radiance))
        records.append(record(f"{i}.exr", azimuth))
    skies = load_skies(tmp_path, records)
    assert skies.shape == (4, 32, 128, 3)
    solid = DirectionGrid.sky(32).solid_angles.reshape(32, 128)
    mean = (luminance(skies).double() * solid).sum((1, 2)) / (2 * math.pi)
    torch.testing.assert_close(mean, torch.ones(4, dtype=torch.float64), rtol=1e-6, atol=0)
    for sky in skies:
        found = EnvironmentMap(radiance=sky).brightest_direction()
        wanted = direction_from_angles(
            torch.tensor(centre_column_azimuth(32)), torch.tensor(0.9)
        ).double()
        assert float(angle_between(found, wanted).rad2deg()) < 0.7
    torch.testing.assert_close(skies[0], skies[2], rtol=0.1, atol=0.3)


def test_black_and_missing_maps(tmp_path: Path) -> None:
    write_environment_map(tmp_path / "a.exr", EnvironmentMap(radiance=torch.ones(16, 64, 3)))
    write_environment_map(tmp_path / "b.exr", EnvironmentMap(radiance=torch.zeros(16, 64, 3)))
    records = [record("a.exr", layout="skylatlong"), record("b.exr", layout="skylatlong")]
    with pytest.raises(InputError, match=r"b\.exr: the map is all black"):
        load_skies(tmp_path, records, height=8)
    with pytest.raises(InputError, match=r"gone\.exr"):
        load_skies(tmp_path, [record("gone.exr")])
    with pytest.raises(InputError, match="sky 1 of 2"):
        normalise(torch.stack([torch.ones(8, 32, 3), torch.zeros(8, 32, 3)]))
