import numpy as np

from skylight.probes.fabrication._files import shaded_picture
from skylight.probes.fabrication._parts import box, part_of


def test_colours_stand_where_the_parts_are() -> None:
    """A red cube to the right of a green one and a blue one above, on white."""
    cubes = [
        part_of(name, box(np.array([x, y, 0.0]), np.array([x + 1.0, y + 1.0, 1.0])))
        for name, x, y in (("red", 2.0, 0.0), ("green", 0.0, 0.0), ("blue", 0.0, 2.0))
    ]
    picture = shaded_picture(
        cubes,
        np.eye(3) * 0.8 + 0.02,
        size=(60, 60),
        up=(0, 1, 0),
        azimuth_rad=0.0,
        elevation_rad=0.0,
    ).astype(int)
    assert picture[45, 45].argmax() == 0
    assert picture[45, 15].argmax() == 1
    assert picture[15, 15].argmax() == 2
    assert (picture[15, 45] == 255).all()
