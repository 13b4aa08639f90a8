"""Captures' files, and light of cells that no picture shows."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.partitions._captured import (
    ProbeCapture,
    complete_shading,
    fingerprint,
    load_capture,
    name_cells,
    save_capture,
)
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._seeds import ProbeDesign, load_design, save_design

DESIGN = named_design("14d")
CELLS = Cells.of(DESIGN)
LEAKS = 0.02 * CELLS.neighbours.double()
ALBEDO = torch.tensor([0.7, 0.75, 0.8], dtype=torch.float64)
PROBE = PartitionProbe(CELLS, ALBEDO, response=torch.diag(CELLS.facing) + LEAKS)


def capture() -> ProbeCapture:
    area = torch.where(torch.arange(14) % 5 > 0, 80.0, 0.0).double()
    shading = torch.rand(14, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return replace(
        ProbeCapture.blank(DESIGN, ALBEDO),
        shading=shading * (area > 0)[:, None],
        area_px=area,
        clipped=torch.where(area > 0, 0.01, 0.0).double(),
        saturated=torch.arange(14) == 5,
        disagreement=torch.where(area > 0, 0.02, torch.nan).double(),
    )


def test_a_file_holds_all(tmp_path: Path) -> None:
    made = capture()
    save_capture(tmp_path / "c.json", made)
    read = load_capture(tmp_path / "c.json")
    for name in ("shading", "area_px", "clipped", "saturated", "disagreement", "albedo", "known"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))
    read.require_design(DESIGN)
    assert json.loads((tmp_path / "c.json").read_text())["cells"][0]["disagreement"] is None


def test_a_capture_is_of_one_design(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'14d' .* '6d'"):
        capture().require_design(named_design("6d"))
    # the same seeds in another file are the same design, other merges are not
    save_design(tmp_path / "d.json", DESIGN)
    assert fingerprint(load_design(tmp_path / "d.json")) == fingerprint(DESIGN)
    merged = ProbeDesign.of("14d", DESIGN.seeds, [[0, 6]])
    assert fingerprint(merged) != fingerprint(DESIGN)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "of format 2"),
        ({"cells": []}, "not those"),
        ({"cells": [{"shading": [1, 2]}]}, "not those"),
        ({"kernel_albedo": [0.5, 0.5]}, "not those"),
        ({"kernel_albedo": [0.5, 0.5, 1.5]}, "albedo is"),
        ({"kind": "x"}, "kind"),
        # of a cell
        ({"clipped": -1.0}, "finite"),
        ({"shading": [0.1, -0.1, 0.1]}, "finite"),
        ({"known": False}, "area_px"),
        ({"area_px": "big"}, "not those"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, change: dict, message: str) -> None:
    path = tmp_path / "c.json"
    save_capture(path, capture())
    content = json.loads(path.read_text())
    (content if change.keys() <= content.keys() else content["cells"][1]).update(change)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        load_capture(path)


class TestCompletion:
    def test_even_light_is_completed_exactly(self) -> None:
        """By any number of cells, and though walls leak."""
        light = torch.tensor([0.3, 0.5, 0.2], dtype=torch.float64).expand(14, 3)
        shading = ALBEDO / torch.pi * (PROBE.response @ light)
        known = torch.arange(14) % 2 == 0
        found = complete_shading(shading * known[:, None], known, PROBE)
        torch.testing.assert_close(found, shading)

    def test_one_missing_cell_has_its_neighbours_mean_light(self) -> None:
        generator = torch.Generator().manual_seed(4)
        light = torch.rand(14, 3, dtype=torch.float64, generator=generator)
        light[6] = light[CELLS.neighbours[6]].mean(0)
        shading = ALBEDO / torch.pi * (PROBE.response @ light)
        known = torch.arange(14) != 6
        found = complete_shading(shading * known[:, None], known, PROBE)
        torch.testing.assert_close(found, shading)
        torch.testing.assert_close(PROBE.light(found[None])[0], light)

    def test_what_is_known_stays(self) -> None:
        shading = torch.rand(14, 3, generator=torch.Generator().manual_seed(5))
        known = torch.arange(14) > 4
        found = complete_shading(shading, known, PROBE)
        assert torch.equal(found[known], shading[known])
        assert torch.equal(complete_shading(shading, known | True, PROBE), shading)

    def test_too_few_cells_are_refused(self) -> None:
        with pytest.raises(InputError, match="only 6 of 14 cells"):
            complete_shading(torch.ones(14, 3), torch.arange(14) < 6, PROBE)


def test_cells_are_named_by_where_they_look() -> None:
    turned = torch.tensor([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    one = torch.tensor([True, False, False])
    assert name_cells(one, turned) == "cell 0 towards (0.00, 0.00, -1.00)"
    many = name_cells(torch.ones(9, dtype=torch.bool), torch.eye(3).repeat(3, 1))
    assert many.endswith("cell 3 towards (1.00, 0.00, 0.00) and 5 others")
