"""Designs: there and back through files, and everything that is refused."""

import json
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.probes.partitions._seeds import ProbeDesign, load_design, save_design

CUBE = torch.cat([torch.eye(3), -torch.eye(3)]).double()


def written(folder: Path, **changes: object) -> Path:
    content = {
        "kind": "partition probe design",
        "format": 1,
        "name": "own",
        "seeds": (2 * CUBE).tolist(),
        "merges": [[1, 5]],
    }
    content.update(changes)
    path = folder / "design.json"
    path.write_text(json.dumps(content))
    return path


def test_a_saved_design_reads_back_the_same(tmp_path: Path) -> None:
    seeds = torch.randn(20, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    design = ProbeDesign.of("some", seeds, [[3, 1], [19, 0, 7]], oriented=True)
    save_design(tmp_path / "d.json", design)
    back = load_design(tmp_path / "d.json")
    assert (back.name, back.oriented, back.merges) == ("some", True, [[0, 7, 19], [1, 3]])
    torch.testing.assert_close(back.seeds, design.seeds, rtol=0, atol=1e-15)
    assert torch.equal(back.labels, design.labels)


def test_files_hold_seeds_of_any_length_and_merges(tmp_path: Path) -> None:
    design = load_design(written(tmp_path))
    assert torch.equal(design.seeds, CUBE)
    assert design.labels.tolist() == [0, 1, 2, 3, 4, 1]
    assert design.count == 5
    assert not design.oriented


@pytest.mark.parametrize(
    ("merges", "reason"),
    [
        ([[0, 6]], r"seed 6; .* 0\.\.5"),
        ([[0, -1]], "seed -1"),
        ([[0, 1], [2, 1]], "seed 1 .* twice"),
        ([[2, 2]], "seed 2 .* twice"),
        ([[2]], "two seeds or more"),
    ],
)
def test_merges_that_make_no_sense_are_refused(merges: list[list[int]], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        ProbeDesign.of("x", CUBE, merges)


@pytest.mark.parametrize(
    ("seeds", "reason"),
    [
        (torch.cat([CUBE, CUBE[2:3] + 1e-5]), "2 and 6"),
        (torch.cat([CUBE, torch.zeros(1, 3).double()]), "seed 6 is zero"),
        (torch.cat([CUBE, torch.full((1, 3), torch.inf).double()]), "finite"),
        (CUBE[:3], "got 3"),
        (CUBE[[0, 1, 3, 4]], "on one circle"),
        (CUBE[:5], "hemisphere"),
        (torch.tensor([[1, 0, 1.0], [0, 1, 1], [-1, 0, 1], [0, -1, 1]]).double(), "one circle"),
    ],
)
def test_seeds_that_cannot_part_the_sphere_are_refused(seeds: torch.Tensor, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        ProbeDesign.of("x", seeds)


def test_a_fifth_seed_under_four_is_enough() -> None:
    seeds = torch.tensor([[1, 0, 1.0], [0, 1, 1], [-1, 0, 1], [0, -1, 1], [0, 0, -1]]).double()
    assert ProbeDesign.of("x", seeds).count == 5


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"kind": "camera intrinsics"}, "kind"),
        ({"format": 2}, "this version reads 1"),
        ({"name": " "}, '"name"'),
        ({"seeds": []}, '"seeds"'),
        ({"seeds": [[1, 0]]}, '"seeds"'),
        ({"seeds": [[1, 0, "0"]]}, '"seeds"'),
        ({"merges": [0, 1]}, '"merges"'),
        ({"merges": [[0, 1.5]]}, '"merges"'),
        ({"oriented": 1}, "true or false"),
        ({"merges": [[0, 9]]}, "seed 9"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path: Path, changes: dict, reason: str) -> None:
    path = written(tmp_path, **changes)
    with pytest.raises(InputError, match=reason) as caught:
        load_design(path)
    assert str(path) in str(caught.value)


def test_labels_must_number_the_cells() -> None:
    with pytest.raises(InputError, match="numbered"):
        ProbeDesign(name="x", seeds=CUBE, labels=torch.tensor([0, 1, 2, 3, 5, 5]))
