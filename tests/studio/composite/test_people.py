"""The spheres that stand for a head in mirrors, against the head itself."""

import numpy as np
import pytest
import torch

from skylight.faces._model import HeadModel
from skylight.sphere._frame import DirectionGrid
from skylight.transport._rays import Raycaster
from tests.studio.composite.composite_modules import called

# where balls hang: 20 to 30 cm beside the head's middle, metres
PLACES = [[0.2, 0.0, 0.0], [-0.2, 0.05, 0.05], [0.25, -0.1, 0.0], [-0.3, 0.1, -0.05]]


@pytest.mark.parametrize("place", PLACES)
def test_the_spheres_cover_what_the_head_covers(place: list[float]) -> None:
    spheres, together = called("people", ("HEAD_SPHERES",), ("TOGETHER",))
    model = HeadModel.load()
    shape = model.vertices(model.average, np.zeros(len(model.expression_names)))
    caster = Raycaster(torch.from_numpy(shape), torch.tensor(model.faces))
    towards = DirectionGrid.hammersley(20_000).directions
    origin = torch.tensor([place], dtype=torch.float64)
    head = caster.occluded(origin.expand(len(towards), 3), towards).numpy()
    covered, total = np.zeros(len(towards), bool), 0
    for *centre, radius in spheres:
        to = np.array(centre) - place
        along = towards.numpy() @ to
        hit = (along > 0) & (to @ to - along**2 < radius**2)
        covered |= hit
        total += hit.sum()
    assert (covered ^ head).sum() / head.sum() < 0.1
    assert covered.sum() / total == pytest.approx(together, abs=0.03)


def test_of_many_people_those_are_reflected_that_look_largest_from_the_object() -> None:
    """An object beside the second person: his spheres come before the first person's."""
    first, second = ({"x": x, "y": 0.0, "z": -1.0, "w": 0.1} for x in (-0.5, 0.5))
    small = {"x": 0.8, "y": 0.0, "z": -1.0, "w": 0.01}
    beside = {"x": 0.7, "y": 0.0, "z": -1.0}
    spheres = [first, second, small]
    (order, one) = called(
        "people", ("largestFrom", beside, spheres, 3), ("largestFrom", beside, spheres, 1)
    )
    assert order == [1, 2, 0]
    assert one == [1]
