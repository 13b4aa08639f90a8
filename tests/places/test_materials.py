"""What places are made of, and what stands in them, for any draw."""

import math

import numpy as np
import pytest
import torch

from skylight.places._materials import CROWNS, DYED, FACADES, FLOORS, FURNITURE, GROUNDS, Draw
from skylight.places._outdoors import canopy, night
from skylight.places._scene import Scene, Surfaces
from skylight.places._stages import street, studio
from skylight.sphere._frame import DirectionGrid

SAMPLES = [
    *(samples for _, samples, _ in (*GROUNDS.values(), *FLOORS)),
    *FACADES,
    *FURNITURE,
    CROWNS,
    DYED,
]


def draws(seed: int) -> Draw:
    return Draw(np.random.default_rng(seed))


def test_samples_are_reflectances() -> None:
    assert all(0 < value < 1 for samples in SAMPLES for each in samples for value in each)
    assert math.fsum(share for share, _, _ in GROUNDS.values()) == pytest.approx(1)
    assert math.fsum(share for share, _, _ in FLOORS) == pytest.approx(1)


@pytest.mark.parametrize("samples", SAMPLES)
def test_colours_lie_between_samples(samples: tuple) -> None:
    """Red and blue over green; brightness, which varies beside, leaves these as they are."""

    def hues(rows: np.ndarray) -> np.ndarray:
        return np.log(rows[:, [0, 2]] / rows[:, 1:2])

    wanted = hues(np.array(samples))
    found = hues(np.array([draws(k).between(samples) for k in range(40)]))
    assert (found >= wanted.min(0) - 1e-9).all()
    assert (found <= wanted.max(0) + 1e-9).all()


def test_walls_are_never_purple() -> None:
    """Of many vivid ones: none has both more red and more blue than green, to speak of."""
    red, green, blue = np.array([draws(k).paint(0.5, 0.1, vivid=1.0).albedo for k in range(300)]).T
    # the geometric mean is e^0.3 = 1.35 above green for a colour three deviations from none
    assert (np.sqrt(red * blue) / green).max() < 1.4
    assert (red / blue).max() > 2
    assert (blue / red).max() > 1.5


def test_gaps_between_leaves_follow_their_law() -> None:
    """exp(-L / (2 sin e)) of the ring at an elevation e, over many crowns."""
    sky = torch.ones(16, 64, 3)
    sine = DirectionGrid.sky(16).directions[:, 1].reshape(16, 64)[:, 0]
    area, count = 1.5, 40
    cover = sum(
        canopy(sky, draws(k), torch.Generator().manual_seed(k), leaf_area=area)[0].mean((1, 2))
        for k in range(count)
    )
    shown = 1 - cover / count
    wanted = torch.exp(-area / (2 * sine)).float()
    assert float(wanted.max()) > 0.4
    # the rings about the zenith see one place, 40 of which are off by 0.08 (one deviation)
    torch.testing.assert_close(shown[3:], wanted[3:], rtol=0, atol=0.07)
    torch.testing.assert_close(shown[:3], wanted[:3], rtol=0, atol=0.3)


def backs_near(scene: Scene, place: np.ndarray, reach: float) -> bool:
    """Whether a place is inside something, or within reach of being so."""
    surfaces = Surfaces.of([each for each in scene.rectangles if not np.any(each.radiance)])
    directions = DirectionGrid.hammersley(64).directions.float()
    starts = torch.tensor(place, dtype=torch.float32).expand(len(directions), 3)
    which, where = surfaces.hit(starts, directions)
    on = which >= 0
    behind = (directions[on] * surfaces.normal[which[on]]).sum(1) > 0
    near = (where[on] - starts[on]).norm(dim=1) < reach
    return bool((behind & near).any())


@pytest.mark.parametrize("kind", ["street", "studio"])
def test_lamps_hang_in_the_open(kind: str) -> None:
    """None reaches into a wall, whose points would be lit by half of its draws."""
    for seed in range(12):
        draw = draws(seed)
        scene = studio(draw) if kind == "studio" else street(night(draw), draw)
        for lamp in scene.lamps:
            assert not backs_near(scene, np.asarray(lamp.position), lamp.radius_m), seed
