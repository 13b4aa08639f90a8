"""The drawn sphere shows the cells where they are."""

import numpy as np
import torch

from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._picture import cell_colours, draw_cells


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
