"""What people and files are told of an estimate's doubt."""

import json
import math

import pytest
import torch

from skylight.estimation._summary import (
    describe_posterior,
    edge_density,
    posterior_map,
    region_lines,
    sure_of_the_sun,
)
from skylight.inverse._posterior import SunPosterior, region_parts, smallest_region
from skylight.sphere._frame import DirectionGrid, direction_from_angles, pixel_from_direction

GRID = DirectionGrid.sky(32)


def posterior_about(*angles_deg, kappa=100.0, floor=0.0, is_seen=True):
    density = floor * (1 + 1e-3 * torch.sin(torch.arange(len(GRID)).double()))
    for azimuth, zenith in angles_deg:
        sun = direction_from_angles(*torch.tensor([azimuth, zenith]).double().deg2rad())
        density += torch.exp(kappa * (GRID.directions @ sun - 1))
    density /= density @ GRID.solid_angles
    region = smallest_region(density, GRID.solid_angles)
    return SunPosterior(
        grid=GRID,
        density=density,
        region=region,
        parts=region_parts(GRID, density, region),
        sun_gain=0.4,
        exposure_interval=(1.0, 3.0),
        albedo_scale_interval=(0.6, 1.7),
        is_seen=is_seen,
    )


def test_the_map_holds_the_density_above_and_nothing_below():
    found = posterior_map(posterior_about((40.0, 50.0)))
    assert found.layout == (64, 128)
    assert float(found.upper().integrate()[0]) == pytest.approx(1, abs=1e-5)
    assert float(found.radiance[32:].abs().max()) == 0


def test_numbers_are_plain_and_name_each_part():
    posterior = posterior_about((40.0, 50.0), (-100.0, 30.0))
    found = describe_posterior(posterior)
    again = json.loads(json.dumps(found))
    zeniths = sorted(part["zenith_deg"] for part in again["region_parts"])
    assert zeniths == pytest.approx([30, 50], abs=1.5)
    assert sum(part["share"] for part in again["region_parts"]) == pytest.approx(0.9, abs=0.02)
    cap = 2 * math.pi * (1 - math.cos(math.radians(again["region_radius_deg"])))
    assert cap == pytest.approx(again["region_sr"])
    inside = GRID.solid_angles[posterior.density >= again["region_edge_per_sr"]].sum()
    assert float(inside) == pytest.approx(again["region_sr"], rel=0.03)


@pytest.mark.parametrize(
    ("is_seen", "words"),
    [(True, "90 % sure within a circle of 12° radius"), (False, "none for certain:")],
)
def test_the_line_for_people(is_seen, words):
    # 90 % of this lobe lie within acos(1 - ln 10 / 100)
    assert words in sure_of_the_sun(posterior_about((40.0, 50.0), is_seen=is_seen))


@pytest.mark.parametrize("floor", [0.0, 3e-4, 1.0])
def test_the_edge_keeps_clear_of_a_flat_sky(floor):
    """A lobe holds 1/16 at a height of 1: with a floor of 3e-4 it is 97 % of all; of 1, 1 %."""
    posterior = posterior_about((40.0, 50.0), floor=floor)
    level = edge_density(posterior)
    mass = posterior.density * posterior.grid.solid_angles
    enclosed = float(mass[posterior.density >= level].sum())
    assert enclosed == pytest.approx(1.0 if floor == 1.0 else 0.9, abs=0.02)


def test_a_lobe_that_holds_a_little_less_than_the_region_is_drawn_alone():
    """The rest of the region is somewhere in a flat sky, where no edge means anything."""
    posterior = posterior_about((40.0, 50.0), floor=1.5e-3)
    inside = posterior.density >= edge_density(posterior)
    sun = direction_from_angles(*torch.tensor([40.0, 50.0]).double().deg2rad())
    away = torch.acos((GRID.directions @ sun).clamp(-1, 1)).rad2deg()
    assert float(away[posterior.region].max()) > 60  # it goes all over
    assert float(away[inside].max()) < 40
    mass = float((posterior.density * GRID.solid_angles)[inside].sum())
    assert 0.8 < mass < 0.9


@pytest.mark.parametrize("rows", [64, 128])
def test_the_contour_runs_round_the_sun_at_the_regions_border(rows: int):
    (outline,) = region_lines(posterior_about((40.0, 50.0)), rows)
    sun = direction_from_angles(*torch.tensor([40.0, 50.0]).double().deg2rad())
    row, column = pixel_from_direction(sun, rows, 2 * rows)
    height = (outline[:, 1].max() - outline[:, 1].min()) / 2 * 180 / rows
    assert height == pytest.approx(12.3, abs=1.5)
    assert outline[:, 0].mean() == pytest.approx(float(column), abs=1)
    assert outline[:, 1].mean() == pytest.approx(float(row), abs=1)
    assert region_lines(posterior_about((40.0, 50.0), is_seen=False), rows) == []
    behind = region_lines(posterior_about((179.0, 50.0)), rows)  # over the map's seam
    assert {bool(line[:, 0].mean() > rows) for line in behind} == {False, True}
