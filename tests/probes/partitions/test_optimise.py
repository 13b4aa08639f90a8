import math
from functools import cache

import pytest
import torch

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import (
    RelightingError,
    SearchSettings,
    named_design,
    optimise_design,
    symmetric_design,
    turned_about_vertical,
)
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions.printed._halves import standing_rotation
from skylight.probes.partitions.printed._solids import ProbeSizes, WallNet, face_radii, kernel_solid
from skylight.sphere._frame import DirectionGrid, angle_between
from skylight.transport._scene import evaluation_scene

GRID = DirectionGrid.latlong(16)


@cache
def transport() -> torch.Tensor:
    return evaluation_scene(12, 16).transport.matrix


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def random_lights(count: int, colours: int = 3, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, len(GRID), colours, generator=generator(seed))


def lamps(count: int, seed: int) -> torch.Tensor:
    """Rooms that are dim but for a few windows, 17 to 28 degrees above the horizon."""
    rng = generator(seed)
    light = 0.1 * torch.rand(count, len(GRID), 1, generator=rng)
    for room in light:
        lit = 5 * 32 + torch.randint(2 * 32, (4,), generator=rng)
        room[lit] += 20 * torch.rand(4, 1, generator=rng)
    return light


def few(steps: int = 250, **others) -> SearchSettings:
    return SearchSettings(starts=2, steps=steps, **others)


def test_the_error_is_that_of_what_the_probe_decodes():
    cells = Cells.of(ProbeDesign.of("merged", named_design("14d").seeds.clone(), [[0, 6]]))
    probe, lights = PartitionProbe(cells, 0.6), random_lights(4).double()
    matrix = transport().double()
    true = torch.einsum("md,bdc->bmc", matrix, lights)
    told = torch.einsum("md,bdc->bmc", matrix, probe.decode(probe(lights, GRID), GRID))
    expected = ((told - true).abs().mean((1, 2)) / true.mean((1, 2))).mean()
    error = RelightingError(transport(), lights.float(), GRID).of_cells(cells)
    assert error == pytest.approx(float(expected), rel=1e-4)
    assert error > 0.01


def test_light_that_is_even_in_each_cell_is_relit_without_error():
    cells = Cells.of(named_design("14d-indoor"))
    values = torch.rand(3, 14, 3, generator=generator())
    lights = values[:, cells.cell_of(GRID.directions)]
    assert RelightingError(transport(), lights, GRID).of_cells(cells) < 1e-6


def test_brightness_does_not_count():
    lights, seeds = random_lights(2), named_design("6d").seeds
    brighter = lights * torch.tensor([1.0, 1000.0])[:, None, None]
    error = RelightingError(transport(), lights, GRID).of_seeds(seeds)
    assert RelightingError(transport(), brighter, GRID).of_seeds(seeds) == pytest.approx(
        error, rel=1e-4
    )


def test_seeds_are_cells():
    error = RelightingError(transport(), random_lights(2), GRID)
    design = named_design("38d")
    assert error.of_seeds(design.seeds) == pytest.approx(error.of_cells(Cells.of(design)), rel=1e-6)


def test_relaxed_cells_tend_to_cells_and_have_gradients():
    error = RelightingError(transport(), random_lights(2), GRID)
    # no direction of the grid is as far from two of them
    seeds = named_design("14d").seeds + 0.05 * torch.rand(14, 3, generator=generator()).double()
    seeds = (seeds / seeds.norm(dim=1, keepdim=True)).requires_grad_()
    assert float(error.relaxed(seeds, 1e5)) == pytest.approx(error.of_seeds(seeds), rel=1e-3)
    (slope,) = torch.autograd.grad(error.relaxed(seeds, 10.0), seeds)
    step = 1e-2 * slope / slope.norm()
    with torch.no_grad():
        ahead, behind = (error.relaxed(seeds + way * step, 10.0) for way in (1, -1))
    assert float(ahead - behind) == pytest.approx(2e-2 * float(slope.norm()), rel=0.02)


def test_a_cell_between_the_grids_directions_is_infinitely_bad():
    seeds = named_design("14d").seeds
    near = seeds[:1] + torch.tensor([[0, 1e-4, 0]], dtype=torch.float64)
    error = RelightingError(transport(), random_lights(2), GRID)
    pole = torch.tensor([[0.0, 1.0, 0.0], [1e-3, 1.0, 0.0], [-1e-3, 1.0, 0.0]]).double()
    squeezed = torch.cat([seeds, near, pole / pole.norm(dim=1, keepdim=True)])
    assert error.of_seeds(squeezed) == math.inf


def test_light_that_reaches_nothing_is_refused():
    below = torch.zeros(2, len(GRID), 3)
    below[0] = 1
    with pytest.raises(InputError, match="light 1"):
        RelightingError(transport(), below, GRID)


def test_turns_go_evenly_round_the_vertical():
    maps = torch.rand(2, 16, 32, 3, generator=generator())
    turned = turned_about_vertical(maps, 8, generator()).reshape(2, 8, 16, 32, 3)
    torch.testing.assert_close(turned.mean(3), maps.mean(2)[:, None].expand(2, 8, 16, 3))
    torch.testing.assert_close(turned[:, 1], turned[:, 0].roll(4, 2), atol=1e-5, rtol=1e-4)
    assert not torch.allclose(turned[:, 0], maps, atol=0.1)


def test_a_searched_design_beats_the_even_one_in_rooms_it_has_not_seen():
    seen = RelightingError(transport(), lamps(24, seed=1), GRID)
    unseen = RelightingError(transport(), lamps(24, seed=2), GRID)
    design = optimise_design("found", 14, seen, generator(), settings=few())
    even = symmetric_design(14)
    assert unseen.of_seeds(design.seeds) < 0.8 * unseen.of_seeds(even.seeds)
    assert int((design.seeds[:, 1] > 0).sum()) > int((even.seeds[:, 1] > 0).sum())


@pytest.mark.parametrize("count", [6, 14, 38])
def test_searched_designs_can_be_printed_and_stand_as_they_were_judged(count):
    error = RelightingError(transport(), lamps(4, seed=1), GRID)
    design = optimise_design("found", count, error, generator(), settings=few(60))
    cells = Cells.of(design)
    apart = torch.pdist(design.seeds)
    assert float(apart.min()) >= 2 * math.sin(few().width(count) / 2) - 1e-9
    for seed, region in zip(design.seeds, cells.regions, strict=True):
        reach = angle_between(region, seed.expand_as(region)).max()
        assert float(reach) <= math.radians(65.0) + 1e-9
    turn = torch.from_numpy(standing_rotation(cells))
    torch.testing.assert_close(turn, torch.eye(3).double(), atol=1e-6, rtol=0)
    net = WallNet.of(cells)
    assert kernel_solid(net, ProbeSizes()).volume() > 0
    assert face_radii(net, ProbeSizes()).min() > 0.4


def test_the_same_seed_finds_the_same_design():
    error = RelightingError(transport(), lamps(4, seed=1), GRID)
    first, second, other = (
        optimise_design("found", 14, error, generator(seed), settings=few(40)) for seed in (3, 3, 4)
    )
    assert torch.equal(first.seeds, second.seeds)
    assert not torch.allclose(first.seeds, other.seeds, atol=1e-3)


def test_progress_goes_from_nothing_towards_all():
    told = []
    error = RelightingError(transport(), lamps(2, seed=1), GRID)
    optimise_design(
        "found", 6, error, generator(), settings=few(100), oriented=True,
        progress=lambda stage, share: told.append((stage, share)),
    )  # fmt: skip
    assert [stage for stage, _ in told] == ["search 1 of 2"] * 2 + ["search 2 of 2"] * 2
    assert [share for _, share in told] == pytest.approx([0, 0.25, 0.5, 0.75])


@pytest.mark.parametrize("count", [6, 9, 14, 20])
def test_symmetric_designs_are_even(count):
    design = symmetric_design(count)
    assert design.count == count
    areas = Cells.of(design).solid_angles * count / (4 * math.pi)
    assert float(areas.min()) > 0.8
    assert float(areas.max()) < 1.25
    assert float(design.seeds.mean(0).norm()) < 0.06


def test_searches_that_cannot_be_are_refused():
    error = RelightingError(transport(), lamps(2, seed=1), GRID)
    with pytest.raises(InputError, match="got 5"):
        optimise_design("found", 5, error, generator())
    with pytest.raises(InputError, match="room"):
        optimise_design("found", 14, error, generator(), settings=few(10, width_rad=1.2))
    with pytest.raises(InputError, match="1 start"):
        SearchSettings(starts=0)
    with pytest.raises(InputError, match="90 degrees"):
        SearchSettings(width_rad=2.0)
    with pytest.raises(InputError, match="85 degrees"):
        SearchSettings(reach_rad=1.6)
