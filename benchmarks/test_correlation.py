"""Seconds for the correlation with all filters, and for codes of one map and of many.

Correlations are compared with the thesis' rotation of the residual, codes of a batch with those of
its maps one by one. Ratios are of medians by turns, so that other work on the machine slows both.
"""

import statistics
import time

import pytest
import torch

from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import builtin
from skylight.csc._positions import Positions
from skylight.csc._wigner import RotationCorrelation
from tests.csc.thesis_gradients import RotatedResiduals

POSITIONS = Positions(rows=32, twists=32)
MAPS, ACTIVATIONS = 32, 16


@pytest.fixture(params=[1, 2], ids=["1 thread", "2 threads"], autouse=True)
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
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
def test_one_gradient(benchmark, method, dictionary, residual, threads):
    """One group a dictionary: pytest-benchmark shows the times relative to the fastest."""
    benchmark.group = f"gradient, K = 40, 32 x 64 x 32, {dictionary}, {threads} threads"
    correlate = METHODS[method](DICTIONARIES[dictionary](), POSITIONS)
    benchmark.pedantic(correlate, (residual,), rounds=5, warmup_rounds=1)
    benchmark.extra_info |= {"threads": threads}


@pytest.mark.parametrize("dictionary", DICTIONARIES)
def test_ratio(benchmark, dictionary, residual, threads):
    """The default is timed, the other before each round."""
    benchmark.group = f"ratio, K = 40, 32 x 64 x 32, {dictionary}, {threads} threads"
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
        "threads": threads,
        "default_s": benchmark.stats["median"],
        "rotated_s": slower,
        "ratio": slower / benchmark.stats["median"],
    }
    print(benchmark.extra_info)


def test_batch(benchmark, threads):
    """Codes of many maps together, against one after the other: seconds, and those of processors.

    A share of 1 would be no gain; on several cores, maps together divide them better.
    """
    benchmark.group = f"{MAPS} maps, ani, {ACTIVATIONS} activations, {threads} threads"
    coder = SphericalSparseCoder("ani", height=32, activations=ACTIVATIONS)
    generator = torch.Generator().manual_seed(2)
    maps = torch.randn(MAPS, 32, 64, 3, generator=generator).exp()
    alone = [coder(one) for one in maps]
    same = coder(maps).filters == torch.stack([code.filters for code in alone])
    assert same.all(1).float().mean() > 0.9  # ties may fall either way
    seconds, of_processors, together = [], [], []

    def one_by_one() -> None:
        begin, of_process = time.perf_counter(), time.process_time()
        for one in maps:
            coder(one)
        seconds.append(time.perf_counter() - begin)
        of_processors.append(time.process_time() - of_process)

    def all_maps() -> None:
        of_process = time.process_time()
        coder(maps)
        together.append(time.process_time() - of_process)

    benchmark.pedantic(all_maps, setup=one_by_one, rounds=3)
    one = statistics.median(seconds)
    benchmark.extra_info |= {
        "threads": threads,
        "one_by_one_s": one,
        "together_s": benchmark.stats["median"],
        "share": benchmark.stats["median"] / one,
        "share_of_processor_seconds": statistics.median(together)
        / statistics.median(of_processors),
    }
    print(benchmark.extra_info)
