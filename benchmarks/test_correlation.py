"""Seconds for the correlation with all filters, against the thesis' rotation of the residual."""

import statistics
import time

import pytest
import torch

from skylight.csc.correlation.positions import Positions
from skylight.csc.correlation.wigner import RotationCorrelation
from skylight.csc.dictionary import builtin
from tools.thesis_gradients import RotatedResiduals

POSITIONS = Positions(rows=32, twists=32)
THREADS = 2


@pytest.fixture(scope="module", autouse=True)
def _threads():
    before = torch.get_num_threads()
    torch.set_num_threads(THREADS)
    yield
    torch.set_num_threads(before)


def without_symmetry() -> torch.Tensor:
    draw = torch.randn(200, 41**2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return torch.nn.functional.normalize(draw, dim=1)


DICTIONARIES = {
    "ani": lambda: builtin("ani").coefficients.detach(),
    "no symmetry": without_symmetry,
}
METHODS = {"default": RotationCorrelation, "rotated residuals": RotatedResiduals}


@pytest.fixture(scope="module")
def residual() -> torch.Tensor:
    return torch.randn(41**2, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("dictionary", DICTIONARIES)
@pytest.mark.parametrize("method", METHODS)
def test_one_gradient(benchmark, method, dictionary, residual):
    """One group a dictionary: pytest-benchmark shows the times relative to the fastest."""
    benchmark.group = f"gradient, K = 40, 32 x 64 x 32, {dictionary}"
    correlate = METHODS[method](DICTIONARIES[dictionary](), POSITIONS)
    benchmark.pedantic(correlate, (residual,), rounds=5, warmup_rounds=1)
    benchmark.extra_info |= {"threads": torch.get_num_threads()}


@pytest.mark.parametrize("dictionary", DICTIONARIES)
def test_ratio(benchmark, dictionary, residual):
    """Both by turns, so that other work on the machine slows them alike; the default is timed."""
    benchmark.group = f"ratio, K = 40, 32 x 64 x 32, {dictionary}"
    filters = DICTIONARIES[dictionary]()
    default, rotated = (method(filters, POSITIONS) for method in METHODS.values())
    a, b = default(residual), rotated(residual)
    assert (a - b).abs().max() < 1e-4 * a.abs().max()
    del a, b
    seconds = []

    def rotate() -> None:
        begin = time.perf_counter()
        rotated(residual)
        seconds.append(time.perf_counter() - begin)

    benchmark.pedantic(default, (residual,), setup=rotate, rounds=7, warmup_rounds=1)
    slower = statistics.median(seconds[1:])
    benchmark.extra_info |= {
        "threads": torch.get_num_threads(),
        "default_s": benchmark.stats["median"],
        "rotated_s": slower,
        "ratio": slower / benchmark.stats["median"],
    }
    print(benchmark.extra_info)
