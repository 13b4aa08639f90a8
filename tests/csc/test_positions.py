import math

import torch

from skylight.csc._positions import Positions, centres_of
from skylight.sphere._frame import DirectionGrid, angle_between
from skylight.sphere._rotation import matrix_from_euler

F64 = torch.float64


def all_places(p: Positions) -> torch.Tensor:
    return torch.cartesian_prod(*(torch.arange(n) for n in (p.rows, p.columns, p.twists)))


def test_counts() -> None:
    assert len(Positions()) == 32 * 64 * 32
    assert len(Positions(rows=3, twists=5)) == len(all_places(Positions(rows=3, twists=5))) == 90


def test_places_look_at_the_pixels_of_a_lat_long_map() -> None:
    positions = Positions(rows=6, twists=3)
    seen = centres_of(positions.rotations(all_places(positions))).reshape(6, 12, 3, 3)
    pixels = DirectionGrid.latlong(6).directions.reshape(6, 12, 3)
    for twist in range(3):
        torch.testing.assert_close(seen[:, :, twist], pixels, atol=1e-14, rtol=0)


def test_rotations_bring_the_zenith_to_the_directions() -> None:
    """In axes (+Z, +X, +Y), whose third is the zenith."""
    positions = Positions(rows=5, twists=4)
    places = all_places(positions)
    matrices = matrix_from_euler(*positions.rotations(places).unbind(1))
    moved = matrices[:, [1, 2, 0], 2]  # its (+Z, +X, +Y) in the world's order
    torch.testing.assert_close(moved, centres_of(positions.rotations(places)), atol=1e-14, rtol=0)
    identity = torch.eye(3, dtype=F64).expand_as(matrices)
    torch.testing.assert_close(matrices @ matrices.mT, identity, atol=1e-14, rtol=0)
    torch.testing.assert_close(torch.linalg.det(matrices), torch.ones(len(places), dtype=F64))


def test_twists_turn_a_filter_about_its_own_middle_counter_clockwise() -> None:
    """As seen from outside: what lay towards +Z of the zenith turns towards +X."""
    positions = Positions(rows=8, twists=8)
    places = torch.tensor([[2, 5, t] for t in range(8)])
    middle = centres_of(positions.rotations(places))[0]
    # the filter's long axis, phi = 0: +Z, first of the three axes
    matrices = matrix_from_euler(*positions.rotations(places).unbind(1))
    axis = matrices[:, [1, 2, 0], 0]
    step = torch.linalg.cross(axis, axis.roll(-1, 0))
    expected = math.sin(2 * math.pi / 8) * middle.expand(8, 3)
    torch.testing.assert_close(step, expected, atol=1e-14, rtol=0)
    # untwisted, it lies along the meridian and looks down
    down = torch.tensor([0.0, -1.0, 0.0], dtype=F64)
    along = torch.nn.functional.normalize(down - (down @ middle) * middle, dim=0)
    torch.testing.assert_close(axis[0], along, atol=1e-14, rtol=0)


def test_rotations_all_differ() -> None:
    positions = Positions(rows=4, twists=3)
    angles = positions.rotations(all_places(positions))
    flat = matrix_from_euler(*angles.unbind(1)).flatten(1)
    apart = torch.cdist(flat, flat) + 10 * torch.eye(len(flat), dtype=F64)
    assert apart.min() > 0.1


def test_places_are_the_nearest_to_rotations() -> None:
    """Of their own angles, of angles a third of a step away, and of whole turns more."""
    positions = Positions(rows=5, twists=6)
    places = all_places(positions)
    angles = positions.rotations(places)
    assert torch.equal(positions.places(angles), places)
    steps = torch.tensor([2 * math.pi / 10, math.pi / 5, 2 * math.pi / 6])
    assert torch.equal(positions.places(angles + 0.3 * steps), places)
    assert torch.equal(positions.places(angles + torch.tensor([2, 0, -4]) * math.pi), places)


def test_columns_go_round_to_the_right() -> None:
    """Neighbours are one step apart, the last and the first too, and +X lies right of -Z."""
    positions = Positions(rows=5, twists=1)
    row = torch.tensor([[2, c, 0] for c in range(10)])  # the horizon
    seen = centres_of(positions.rotations(row))
    steps = angle_between(seen, seen.roll(-1, 0))
    torch.testing.assert_close(steps, torch.full((10,), 2 * math.pi / 10, dtype=F64))
    assert seen[5, 0] > 0 > seen[5, 2]  # just right of the centre
