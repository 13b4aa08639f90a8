"""Named designs and sun paths: counts, symmetry, and where the sun really goes."""

import math
from datetime import date
from itertools import product

import pytest
import torch

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions._sun_path import path_design, path_through, sun_directions, sun_path
from skylight.skies._sun import Place
from skylight.sphere._frame import angle_between

SOFIA = Place(latitude_deg=42.7, longitude_deg=23.3)
EAST = torch.tensor([1.0, 0.0, 0.0]).double()
UP = torch.tensor([0.0, 1.0, 0.0]).double()


@pytest.mark.parametrize("count", [6, 14, 38, 110])
def test_even_designs_have_their_number_and_are_alike_all_round(count: int) -> None:
    design = named_design(f"{count}d")
    assert design.count == len(design.seeds) == count
    assert not design.oriented
    moments = design.seeds.T @ design.seeds / count
    torch.testing.assert_close(moments, torch.eye(3).double() / 3, rtol=0, atol=1e-12)
    assert float(design.seeds.sum(0).norm()) < 1e-12


def test_the_indoor_design_is_finer_above() -> None:
    cells = Cells.of(named_design("14d-indoor"))
    assert cells.count == 14
    above = cells.normals[:, 1] > 0
    assert int(above.sum()) == 11
    assert float(cells.solid_angles[above].max()) < float(cells.solid_angles[~above].min())


@pytest.mark.parametrize(
    ("name", "strip", "count"),
    [
        ("14d-outdoor", 7, 14),
        ("6d-sun-6", 6, 13),
        ("6d-sun-12", 12, 19),
        ("14d-sun-6", 6, 21),
        ("14d-sun-12", 12, 27),
        ("6d-tilted-sun-12", 12, 18),
        ("14d-tilted-sun-12", 12, 26),
    ],
)
def test_sun_designs_part_the_path_into_equal_cells(name: str, strip: int, count: int) -> None:
    cells = Cells.of(named_design(name))
    assert cells.count == count
    assert cells.design.oriented
    tilt = math.radians(30.0) if "tilted" in name else 0.0
    noon = torch.tensor([0.0, math.cos(tilt), math.sin(tilt)]).double()
    angle = (torch.arange(1000).double() + 0.5) * math.pi / 1000
    path = torch.cos(angle)[:, None] * EAST + torch.sin(angle)[:, None] * noon
    expected = (angle / math.pi * strip).long()
    assert torch.equal(cells.cell_of(path), expected)
    sizes = cells.solid_angles[:strip]
    torch.testing.assert_close(sizes, sizes[:1].expand(strip), rtol=1e-9, atol=0)
    assert float(cells.solid_angles[strip:].min()) > 1.8 * float(sizes[0])
    # a width of 20 degrees: 9 to either side is within, 11 is not
    across = torch.linalg.cross(EAST, noon)
    for degrees, inside in ((9, True), (-9, True), (11, False), (-11, False)):
        turn = math.radians(degrees)
        beside = math.cos(turn) * path + math.sin(turn) * across
        assert bool(((cells.cell_of(beside) < strip) == inside).all())


def test_unknown_designs_are_refused_with_the_list() -> None:
    assert "14d-indoor" in design_names()
    with pytest.raises(InputError, match="6d, 14d, 38d, 110d"):
        named_design("7d")


def test_the_middle_point_says_which_way_round() -> None:
    upper, lower = path_through(EAST, UP, -EAST), path_through(EAST, -UP, -EAST)
    torch.testing.assert_close(upper.at([0.5])[0], UP)
    torch.testing.assert_close(lower.at([0.5])[0], -UP)
    for path in (upper, lower):
        assert path.length_rad == pytest.approx(math.pi)
        torch.testing.assert_close(path.at([0.0, 1.0]), torch.stack([EAST, -EAST]))


def test_three_points_of_a_small_circle_give_its_length() -> None:
    """60 degrees from the pole: three quarters of a circle of radius sin 60."""
    turns = torch.tensor([0.0, 0.7, 1.5]).double() * math.pi
    low = math.cos(math.pi / 3) * UP
    points = [low + math.sin(math.pi / 3) * torch.stack([t.cos(), 0 * t, -t.sin()]) for t in turns]
    path = path_through(*points)
    assert path.length_rad == pytest.approx(1.5 * math.pi * math.sin(math.pi / 3))
    torch.testing.assert_close(path.axis, UP)
    torch.testing.assert_close(path.at([0.7 / 1.5])[0], points[1])


def test_points_that_coincide_make_no_path() -> None:
    with pytest.raises(InputError, match="three"):
        path_through(EAST, EAST, UP)


def test_the_sun_is_where_almanacs_say() -> None:
    """At noon of the solstice it stands 90 - latitude + 23.44 degrees high, in the south."""
    path = sun_path(SOFIA, date(2024, 6, 21))
    noon = path.at([0.5])[0]
    assert math.degrees(math.asin(float(noon[1]))) == pytest.approx(90 - 42.7 + 23.44, abs=0.05)
    assert float(noon[2]) > 0
    assert abs(float(noon[0])) < 0.02
    rise, fall = path.at([0.0, 1.0])
    assert float(rise[0]) > 0.7 > -0.7 > float(fall[0])
    # it turns about the celestial pole
    pole = torch.tensor([0.0, math.sin(math.radians(42.7)), -math.cos(math.radians(42.7))])
    assert float(angle_between(path.axis, -pole.double())) < math.radians(0.3)


@pytest.mark.parametrize(
    ("base", "latitude", "day"),
    [
        (("6d", "14d")[number % 2], latitude, day)
        for number, (latitude, day) in enumerate(
            product(
                (-35.0, 1.0, 45.0, 60.0),
                (date(2024, 3, 20), date(2024, 6, 21), date(2024, 12, 21)),
            )
        )
    ],
)
def test_paths_of_all_seasons_hold_the_sun(base: str, latitude: float, day: date) -> None:
    place = Place(latitude_deg=latitude, longitude_deg=-70.0)
    path = sun_path(place, day)
    cells = Cells.of(path_design("own", named_design(base), 6, path))
    sun = sun_directions(place, day)
    sun = sun[sun[:, 1] > math.sin(math.radians(0.5))]
    cell = cells.cell_of(sun)
    assert bool((torch.diff(cell) >= 0).all())
    assert cell.unique().tolist() == list(range(6))
    circle = path.at(torch.linspace(0, 1, 2000).tolist())
    off = (sun @ circle.T).amax(1).clamp(max=1).acos()
    assert float(off.max()) < math.radians(0.3)


@pytest.mark.parametrize(
    ("day", "word"), [(date(2024, 6, 21), "set"), (date(2024, 12, 21), "rise")]
)
def test_where_the_sun_does_not_rise_or_set_there_is_no_path(day: date, word: str) -> None:
    with pytest.raises(InputError, match=f"does not {word}"):
        sun_path(Place(latitude_deg=75.0, longitude_deg=20.0), day)


def test_short_paths_and_strange_numbers_are_refused() -> None:
    base = named_design("6d")
    low = torch.tensor([1.0, 0.05, 0.0]).double()
    short = path_through(EAST, low, torch.tensor([1.0, 0.1, 0.05]).double())
    with pytest.raises(InputError, match="less than 30"):
        path_design("x", base, 6, short)
    midsummer = sun_path(Place(latitude_deg=65.0, longitude_deg=0.0), date(2024, 6, 21))
    with pytest.raises(InputError, match="6 cells"):
        path_design("x", base, 6, midsummer)
    strip = path_design("x", base, 16, midsummer)
    assert Cells.of(strip).count > 16
    whole = path_through(EAST, UP, -EAST)
    with pytest.raises(InputError, match="1 cell or more"):
        path_design("x", base, 0, whole)
