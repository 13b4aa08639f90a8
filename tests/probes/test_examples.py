"""The examples of probes as modules do what they say."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
def test_cells_moved_by_gradient_relight_better() -> None:
    design, before, after = runpy.run_path(str(EXAMPLES / "optimise_probe_cells.py"))["optimise"]()
    assert design.count == 14
    assert after < 0.6 * before


def test_a_sky_is_found_through_the_probe() -> None:
    before, after = runpy.run_path(str(EXAMPLES / "fit_light_through_probe.py"))["fit"]()
    assert float(before) > 30
    assert float(after) < 1
