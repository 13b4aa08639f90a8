"""Missing slots: the thesis' rules, exactness for partitioned light, and brute force."""

from itertools import combinations

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from skylight.errors import InputError
from skylight.probes.voxel._lightmap import Lightmap
from skylight.probes.voxel._model import visibility_vectors
from skylight.probes.voxel._reconstruct import (
    DirectReconstruction,
    SlotReconstruction,
    sparse_combinations,
)
from tests.probes.voxel.shapes import known_of

F64 = torch.float64
LEFT, RIGHT, FORWARD, BACKWARD, TOP = 1, 2, 4, 8, 16


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def terms(module: SlotReconstruction) -> torch.Tensor:
    """Of how many slots each one is a combination."""
    return (module.weights != 0).sum(2)


def test_three_probe_gives_the_rule_of_the_ceiling() -> None:
    """Eq. 3.18: v_top = 4 v_0 - v_left - v_right - v_forward - v_backward."""
    weights = DirectReconstruction(known_of(3)).weights
    expected = torch.zeros(32, dtype=F64)
    expected[0] = 4
    expected[[LEFT, RIGHT, FORWARD, BACKWARD]] = -1
    for o in range(6):
        torch.testing.assert_close(weights[o, TOP], expected, atol=1e-6, rtol=0)


def test_three_probe_gives_the_rule_of_several_occluders() -> None:
    """Eq. 3.19: v_O = sum_o v_o - (|O| - 1) v_0, with v_top by Eq. 3.18."""
    weights = DirectReconstruction(known_of(3)).weights[0]
    for configuration in range(32):
        if configuration in (0, LEFT, RIGHT, FORWARD, BACKWARD, TOP):
            continue
        present = [1 << i for i in range(5) if configuration >> i & 1]
        expected = sum(weights[bit] for bit in present) - (len(present) - 1) * weights[0]
        torch.testing.assert_close(weights[configuration], expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("size", [3, 5, 7])
def test_light_that_neighbours_alone_shadow_is_completed_exactly(size: int) -> None:
    parts = random(6, 5, 4, 4, 3).abs()  # what each partition sends, per orientation and texel
    true = torch.einsum("ci,oixyk->ocxyk", visibility_vectors(), parts).float()
    known = known_of(size)
    captured = torch.where(known[..., None, None, None], true, 7.0)
    module = DirectReconstruction(known)
    torch.testing.assert_close(module(captured), true, atol=2e-5, rtol=2e-5)
    assert int(terms(module).max()) <= 5
    assert (terms(module)[known] == 1).all()


def test_more_known_slots_need_no_more_terms() -> None:
    few, many = (terms(DirectReconstruction(known_of(n))).sum() for n in (3, 7))
    assert int(many) <= int(few)


def test_gradients_flow_to_the_captured_light() -> None:
    module = DirectReconstruction(known_of(3))
    light = random(6, 32, 2, 2, 1).requires_grad_()
    assert gradcheck(module, (light,))


def test_completed_light_is_not_negative_and_keeps_what_was_captured() -> None:
    known = known_of(3)
    radiance = torch.rand(6, 32, 2, 2, 3, generator=torch.Generator().manual_seed(1))
    lightmap = Lightmap(radiance=radiance, coverage=known.float(), confidence=known.float())
    completed = DirectReconstruction(known).complete(lightmap)
    assert (completed.radiance >= 0).all()
    torch.testing.assert_close(completed.radiance[known], radiance[known])


def test_slots_that_were_not_captured_are_named() -> None:
    blank = Lightmap.blank(2)
    module = DirectReconstruction(known_of(3))
    with pytest.raises(InputError, match=r"30 of .*\+x, free"):
        module.complete(blank)
    known = known_of(3)
    known[2] = False
    with pytest.raises(InputError, match=r"\+y"):
        DirectReconstruction(known)


@pytest.mark.parametrize("cost", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_sparse_combinations_are_the_best_of_all_subsets(cost: float, seed: int) -> None:
    known, wanted = random(7, 4, seed=seed), random(5, 4, seed=10 + seed)
    found = sparse_combinations(known, wanted, cost=cost)
    for x, w in zip(found, wanted, strict=True):
        objectives = []
        for size in range(8):
            for subset in combinations(range(7), size):
                rows = known[list(subset)].numpy()
                solution = np.linalg.lstsq(rows.T, w.numpy(), rcond=None)[0] if size else []
                residual = w.numpy() - (rows.T @ solution if size else 0)
                objectives.append((residual @ residual + cost * size, size))
        least = min(objectives)[0]
        fewest = min(s for o, s in objectives if o <= least + 1e-9)
        mine = float((w - known.T @ x).square().sum()) + cost * int((x != 0).sum())
        assert mine == pytest.approx(least, abs=1e-8)
        assert int((x != 0).sum()) == fewest


def test_among_equals_the_smallest_weights_win() -> None:
    """w = 2 a = b / 2, as well."""
    known = torch.tensor([[1.0, 0.0], [4.0, 0.0], [0.0, 1.0]], dtype=F64)
    found = sparse_combinations(known, torch.tensor([[2.0, 0.0]], dtype=F64), cost=0.0)
    assert found.tolist() == [[0, 0.5, 0]]


def test_dependent_rows_are_never_combined() -> None:
    known = torch.tensor([[1.0, 1.0], [1.0, 1.0], [1.0, 0.0]], dtype=F64)
    found = sparse_combinations(known, random(4, 2), cost=0.0)
    assert ((found != 0).sum(1) == 2).all()
    assert ((found[:, 0] == 0) | (found[:, 1] == 0)).all()


def test_more_rows_than_can_be_tried_are_combined_six_at_most() -> None:
    found = sparse_combinations(random(16, 10), random(3, 10, seed=4), cost=0.0)
    assert ((found != 0).sum(1) == 6).all()


def test_weights_are_applied_per_orientation_to_lightmaps_of_any_leading_shape() -> None:
    weights, light = random(6, 32, 32), random(2, 4, 6, 32, 3, 3, 3)
    module = SlotReconstruction(weights, torch.ones(6, 32, dtype=torch.bool))
    expected = torch.einsum("oij,abojxyc->aboixyc", weights, light)
    torch.testing.assert_close(module(light), expected)
    assert module(light.float()).dtype == torch.float32


def test_weights_and_known_slots_are_the_state(device: torch.device) -> None:
    module, light = DirectReconstruction(known_of(5)).to(device), random(6, 32, 2, 2, 3).to(device)
    other = DirectReconstruction(known_of(3)).to(device)
    assert not torch.allclose(other(light), module(light))
    other.load_state_dict(module.state_dict())
    assert set(module.state_dict()) == {"weights", "known"}
    assert torch.equal(other.known, module.known)
    torch.testing.assert_close(other(light), module(light), rtol=0, atol=0)
    torch.testing.assert_close(other.float()(light), module(light), rtol=1e-5, atol=1e-5)
