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


def test_a_voxel_probe_tells_what_other_faces_would_show() -> None:
    shown, others, error = runpy.run_path(str(EXAMPLES / "complete_voxel_lightmap.py"))[
        "complete"
    ]()
    assert (shown, others) == (30, 24)
    assert error < 0.15


def test_points_of_a_known_object_relight_another() -> None:
    """Their noise is 1 %, and 40 numbers hold little more of a sky than its low frequencies."""
    assert runpy.run_path(str(EXAMPLES / "light_from_known_object.py"))["relight"]() < 0.05
