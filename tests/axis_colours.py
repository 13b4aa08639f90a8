"""A map whose colour tells the axis: what a program shows tells which way it looks."""

import torch

from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid

# no two axes share a colour, and opposite ones are complementary
AXES = {
    "px": ((1.0, 0.0, 0.0), (0.9, 0.1, 0.1)),
    "nx": ((-1.0, 0.0, 0.0), (0.1, 0.9, 0.9)),
    "py": ((0.0, 1.0, 0.0), (0.1, 0.9, 0.1)),
    "ny": ((0.0, -1.0, 0.0), (0.9, 0.1, 0.9)),
    "pz": ((0.0, 0.0, 1.0), (0.1, 0.1, 0.9)),
    "nz": ((0.0, 0.0, -1.0), (0.9, 0.9, 0.1)),
}


def axis_map(height: int = 64) -> EnvironmentMap:
    """Each direction has the colour of the axis it is nearest to, in the world frame."""
    directions = DirectionGrid.latlong(height).directions
    axes = torch.tensor([axis for axis, _ in AXES.values()], dtype=torch.float64)
    colours = torch.tensor([colour for _, colour in AXES.values()])
    nearest = (directions @ axes.T).argmax(1)
    return EnvironmentMap(radiance=colours[nearest].reshape(height, 2 * height, 3))
