"""Beside libraries that do one thing well: harmonics by sphericart, turned maps by skylibs.

Both are no requirements: ``pip install sphericart skylibs``, or these skip. By turns, so that other
work on the machine slows both; ratios are of medians of processor seconds, of all threads.
"""

import statistics
import time
from collections.abc import Callable

import pytest
import torch

from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, rotation_about

ROUNDS = 11


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def compared(benchmark, ours: Callable[[], object], theirs: Callable[[], object]) -> None:
    """Times ours, with theirs before each round, and notes the ratio."""
    of_ours, of_theirs = [], []

    def timed(function: Callable[[], object], seconds: list[float]) -> None:
        begin = time.process_time()
        function()
        seconds.append(time.process_time() - begin)

    timed(theirs, [])
    benchmark.pedantic(
        lambda: timed(ours, of_ours),
        setup=lambda: timed(theirs, of_theirs),
        rounds=ROUNDS,
        warmup_rounds=1,
    )
    mine, peer = statistics.median(of_ours[1:]), statistics.median(of_theirs[1:])
    benchmark.extra_info |= {"ours_s": mine, "peer_s": peer, "ratio": mine / peer}
    print(benchmark.extra_info)


@pytest.mark.parametrize("degree", [4, 10, 25])
def test_harmonics(benchmark, degree):
    """100,000 directions in double precision; columns differ in order and sign only."""
    sphericart = pytest.importorskip("sphericart", reason="pip install sphericart")
    benchmark.group = f"harmonics of degree {degree} at 100,000 directions, 1 thread"
    directions = DirectionGrid.hammersley(100_000).directions
    peer, points = sphericart.SphericalHarmonics(degree), directions.numpy()
    theirs = torch.from_numpy(peer.compute(points[:100]))
    torch.testing.assert_close(
        harmonics.evaluate(directions[:100], degree).abs(), theirs.abs(), rtol=0, atol=1e-11
    )
    compared(
        benchmark,
        lambda: harmonics.evaluate(directions, degree),
        lambda: peer.compute(points),
    )


def test_turned_map(benchmark):
    """A lamp of 20 degrees in a grey room of 256 x 512; the light that each loses or makes."""
    envmap = pytest.importorskip("envmap", reason="pip install skylibs")
    benchmark.group = "a map of 256 x 512 turned, 1 thread"
    grid = DirectionGrid.latlong(256)
    lamp = torch.tensor([0.36, 0.48, -0.8], dtype=torch.float64)
    light = 1 + 100 * (grid.directions @ lamp > 0.985).float()
    room = EnvironmentMap(radiance=light.reshape(256, 512, 1).repeat(1, 1, 3))
    axis = torch.tensor([1.0, 2.0, -0.5], dtype=torch.float64)
    turn = rotation_about(axis, 1.1)
    peer = envmap.EnvironmentMap(room.radiance.numpy().copy(), "latlong")

    def theirs():
        return peer.copy().rotate(turn.numpy())

    before = room.integrate()
    errors = {
        "energy_error": room.rotate(turn).integrate() / before - 1,
        "peer_energy_error": EnvironmentMap(
            radiance=torch.from_numpy(theirs().data).float()
        ).integrate()
        / before
        - 1,
    }
    benchmark.extra_info |= {name: float(e.abs().max()) for name, e in errors.items()}
    compared(benchmark, lambda: room.rotate(turn), theirs)
