from itertools import combinations

import pytest
import scipy.linalg
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes._encoder import (
    ObjectEncoder,
    SurfaceTransfer,
    _pivots,
    choose_points,
    surface_points,
)
from skylight.probes.partitions.relight._scene import Scene
from skylight.sphere._frame import DirectionGrid
from tests.probes.objects import GRID, ring_and_ball, solid, transfer_of


@pytest.fixture(scope="module")
def candidates() -> SurfaceTransfer:
    return transfer_of(ring_and_ball(), 300)


def lit_ones(candidates: SurfaceTransfer, count: int) -> SurfaceTransfer:
    """The first that any light reaches: the ball's inside of the ring is dark."""
    reached = candidates.functions.flatten(1).any(1)
    return candidates.at(torch.nonzero(reached)[:count, 0])


def test_points_are_spread_evenly_by_area():
    small, large = trimesh.creation.icosphere(3, 1.0), trimesh.creation.icosphere(2, 2.0)
    large.apply_translation([10, 0, 0])
    scene = Scene.joined([solid(small), solid(large)])
    points = surface_points(scene, 20_000, torch.Generator().manual_seed(0)).positions
    on_small = points[:, 0] < 5
    expected = small.area / (small.area + large.area)
    assert float(on_small.double().mean()) == pytest.approx(expected, abs=0.01)
    assert float(points[on_small].mean(0).norm()) < 0.03
    assert float((points[on_small].norm(dim=1) - 1).abs().max()) < 0.02


def test_pivots_are_those_of_lapack(candidates):
    rows = candidates.weighted().mean(0)
    _, order = scipy.linalg.qr(rows.T.numpy(), mode="r", pivoting=True)
    assert _pivots(rows, 20).tolist() == order[:20].tolist()


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("lit", [False, True])
def test_no_exchange_of_one_point_is_better(candidates, noise, lit):
    """The objective worked out anew, by explicit inverses, for every possible exchange."""
    some = lit_ones(candidates, 60)
    chosen = choose_points(some, 5, noise=noise, lit=some if lit else None).tolist()
    rows = some.weighted().mean(0)
    ridge = noise**2 * rows.square().sum(1).mean()

    def cost(points) -> float:
        mine = rows[list(points)]
        inverse = torch.linalg.inv(mine @ mine.T + ridge * torch.eye(5))
        if not lit:
            return float(inverse.trace())
        across = rows @ mine.T
        return float(rows.square().sum() - (across @ inverse @ across.T).trace())

    least = min(
        cost([*chosen[:i], c, *chosen[i + 1 :]])
        for i in range(5)
        for c in set(range(60)) - set(chosen)
    )
    assert cost(chosen) <= least * 1.002
    assert len(set(chosen)) == 5


def test_few_points_are_chosen_almost_as_well_as_by_trying_all(candidates):
    some = lit_ones(candidates, 30)
    rows = some.weighted().mean(0)
    gram = rows @ rows.T
    every = torch.tensor(list(combinations(range(30), 3)))
    blocks = gram[every[:, :, None], every[:, None, :]]
    traces = torch.linalg.inv(blocks).diagonal(dim1=1, dim2=2).sum(1)
    chosen = choose_points(some, 3)
    mine = torch.linalg.inv(gram[chosen[:, None], chosen]).trace()
    assert float(mine) <= 1.1 * float(traces.min())


def condition(encoder: ObjectEncoder) -> float:
    return float(torch.linalg.cond(encoder.gram).amax().sqrt())


@pytest.mark.parametrize("count", [9, 14, 25])
def test_chosen_points_beat_random_ones_in_conditioning(candidates, count):
    chosen = ObjectEncoder(candidates.at(choose_points(candidates, count)))
    generator = torch.Generator().manual_seed(3)
    random = [
        ObjectEncoder(
            candidates.at(torch.randperm(len(candidates), generator=generator)[:count]), noise=0.01
        )
        for _ in range(9)
    ]
    conditions = sorted(condition(encoder) for encoder in random)
    assert condition(chosen) < 0.5 * conditions[4]
    assert condition(chosen) < conditions[0]


def test_what_is_chosen_for_relighting_relights_best(candidates):
    """Another body under white noise, noise 1 %: chosen for that, for conditioning, by chance."""
    body = transfer_of(solid(trimesh.creation.icosphere(3)), 200, seed=5)
    generator = torch.Generator().manual_seed(4)
    light = torch.randn(200, len(GRID), 3, generator=generator, dtype=torch.float64)
    truth = body.shading(light)

    def error(points) -> float:
        encoder = ObjectEncoder(candidates.at(points), noise=0.01).requires_grad_(False)
        shading = encoder(light)
        disturbance = torch.randn(shading.shape, generator=generator, dtype=torch.float64)
        decoded = encoder.decode(shading + 0.01 * shading.square().mean().sqrt() * disturbance)
        return float((body.shading(decoded) - truth).square().mean().sqrt())

    for_body = error(choose_points(candidates, 14, noise=0.01, lit=body))
    assert for_body < 0.9 * error(choose_points(candidates, 14, noise=0.01))
    chance = [error(torch.randperm(300, generator=generator)[:14]) for _ in range(5)]
    assert for_body < 0.9 * min(chance)


def test_refusals(candidates):
    with pytest.raises(InputError, match="one point or more"):
        choose_points(candidates, 0)
    with pytest.raises(InputError, match="give more"):
        choose_points(candidates, 301)
    same = SurfaceTransfer(functions=candidates.functions[:2].repeat(4, 1, 1), grid=GRID)
    with pytest.raises(InputError, match="only 2 lights"):
        choose_points(same, 3)
    other = DirectionGrid.latlong(8)
    coarse = SurfaceTransfer(functions=torch.ones(2, len(other), 3), grid=other)
    with pytest.raises(InputError, match="one and the same grid"):
        choose_points(candidates, 3, lit=coarse)
    with pytest.raises(InputError, match="at least one"):
        surface_points(ring_and_ball(), 0, torch.Generator())
