"""Cells of merged regions, designs that cannot be built, and cells drawn on the sphere."""

import math

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import design_names, named_design
from skylight.probes.partitions._picture import cell_colours, draw_cells
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.sphere._frame import DirectionGrid

CUBE = torch.cat([torch.eye(3), -torch.eye(3)]).double()
CORNERS = torch.cartesian_prod(*[torch.tensor([1.0, -1.0])] * 3).double() / math.sqrt(3)
CUBOID = torch.cat([CUBE, CORNERS])  # faces and corners of a cube: seed 6 is (1, 1, 1)


def cells_of(seeds: torch.Tensor, *merges: list[int]) -> Cells:
    return Cells.of(ProbeDesign.of("x", seeds, merges))


@pytest.mark.parametrize("name", design_names())
def test_every_named_design_adds_up(name: str) -> None:
    cells = Cells.of(named_design(name))
    assert abs(float(cells.solid_angles.sum()) - 4 * math.pi) < 1e-12
    gathered = cells.clamped_cosine(cells.normals)
    assert float((gathered.sum(1) - math.pi).abs().max()) < 1e-12
    torch.testing.assert_close(gathered.diagonal(), cells.facing, rtol=0, atol=1e-13)
    for label, region in zip(cells.design.labels.tolist(), cells.regions, strict=True):
        assert bool((region @ cells.normals[label] > 0.01).all())


def test_merged_cells_are_the_sum_of_their_regions() -> None:
    apart, merged = cells_of(CUBOID), cells_of(CUBOID, [0, 6])
    normals = torch.tensor([[0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [-1.0, 0.0, 0.0]]).double()
    separate, together = apart.clamped_cosine(normals), merged.clamped_cosine(normals)
    torch.testing.assert_close(together[:, 0], separate[:, 0] + separate[:, 6])
    others = [i for i in range(14) if i not in (0, 6)]
    torch.testing.assert_close(together[:, 1:], separate[:, others])
    torch.testing.assert_close(
        merged.solid_angles[0], apart.solid_angles[0] + apart.solid_angles[6]
    )
    # in no direction are the two seen better than along their common normal
    assert torch.equal(merged.normals[1:], CUBOID[others])
    around = merged.normals[:1] + 0.05 * torch.cat([torch.eye(3), -torch.eye(3)]).double()
    around = around / around.norm(dim=1, keepdim=True)
    assert bool((merged.clamped_cosine(around)[:, 0] < merged.facing[0]).all())


def test_a_direction_belongs_to_the_closest_seed_s_cell() -> None:
    cells = cells_of(CUBOID, [0, 6])
    directions = torch.tensor([[2.0, 0.5, 0.1], [1.0, 1.1, 0.9], [0.0, 3.0, 0.0]])
    assert cells.cell_of(directions).tolist() == [0, 0, 1]
    grid = DirectionGrid.hammersley(100_000)
    areas = torch.bincount(cells.cell_of(grid.directions)) * grid.solid_angles[0]
    torch.testing.assert_close(areas, cells.solid_angles, rtol=0.01, atol=0)


def test_neighbours_share_a_wall() -> None:
    near = cells_of(CUBE).neighbours
    for i in range(6):
        assert torch.nonzero(~near[i])[:, 0].tolist() == sorted([i, (i + 3) % 6])
    apart, merged = cells_of(CUBOID).neighbours, cells_of(CUBOID, [0, 6]).neighbours
    others = [i for i in range(14) if i not in (0, 6)]
    assert torch.equal(merged[0, 1:], (apart[0] | apart[6])[others])
    assert not bool(merged.diagonal().any())


def test_merges_must_hang_together() -> None:
    with pytest.raises(InputError, match=r"\[0, 3\]"):
        cells_of(CUBE, [0, 3])


def test_cells_must_be_seen_by_their_faces() -> None:
    # two faces of a cube reach just to the horizon of what lies between them
    with pytest.raises(InputError, match="horizon"):
        cells_of(CUBE, [0, 1])
    with pytest.raises(InputError, match="horizon"):
        cells_of(CUBE, [0, 1, 2, 3, 4, 5])  # whose normal is nowhere


def test_cells_round_others_have_walls_that_nothing_holds() -> None:
    ring = torch.tensor(
        [[math.cos(a) * 0.5, 1.0, math.sin(a) * 0.5] for a in torch.arange(6) * math.pi / 3]
    ).double()
    seeds = torch.cat([CUBE, ring])
    assert cells_of(seeds, [6, 7, 8, 9, 10]).count == 8
    with pytest.raises(InputError, match="nothing would hold"):
        cells_of(seeds, [6, 7, 8, 9, 10, 11])


def hue_of(pixel: np.ndarray) -> np.ndarray:
    value = pixel.astype(float)
    return value / value.max()


def test_a_cube_seen_along_an_axis_shows_one_face_each_way() -> None:
    cells = Cells.of(named_design("6d"))
    picture = draw_cells(cells, size=120, elevation_rad=0.0, azimuth_rad=0.0)
    assert picture.shape == (120, 240, 3)
    assert picture.dtype == np.uint8
    colours = cell_colours(cells).numpy()
    front, back = cells.cell_of(torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])).tolist()
    right, left, top = cells.cell_of(
        torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    ).tolist()
    # seeds are white at the middle of either view; beside them are the faces' colours
    np.testing.assert_allclose(hue_of(picture[60, 60]), 1, atol=0.01)
    # a face's border is at 45 degrees, 0.71 of the radius
    places = [((60, 75), front), ((60, 110), right), ((60, 10), left), ((10, 60), top)]
    places += [((60, 195), back), ((60, 230), left), ((60, 130), right)]
    for (row, column), cell in places:
        np.testing.assert_allclose(hue_of(picture[row, column]), colours[cell], atol=0.03)
    assert picture[:, :58].max(2)[60].min() < 100, "a dark border between front and left"
    assert (picture[0, 0] == 255).all()


def test_neighbours_differ_in_colour() -> None:
    for name in ("38d", "14d-tilted-sun-12"):
        cells = Cells.of(named_design(name))
        colours = cell_colours(cells)
        apart = torch.cdist(colours, colours)
        assert float(apart[cells.neighbours].min()) > 0.2
