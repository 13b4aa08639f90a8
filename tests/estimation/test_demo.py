"""The scores of the demonstration."""

import pytest
import torch

from skylight.estimation._demo import score
from skylight.sphere._envmap import EnvironmentMap


@pytest.mark.parametrize("rows", [64, 128])
def test_an_estimate_on_any_rows_is_scored_on_those_of_the_truth(rows: int) -> None:
    def lit_from(rows: int, level: float) -> EnvironmentMap:
        radiance = torch.full((rows, 2 * rows, 3), level)
        radiance[: rows // 2] *= 3
        return EnvironmentMap(radiance=radiance)

    right = score(lit_from(rows, 0.2), lit_from(64, 0.2))
    assert right["rmse"] < 1e-3
    assert score(lit_from(rows, 0.3), lit_from(64, 0.2))["rmse"] > 0.1
