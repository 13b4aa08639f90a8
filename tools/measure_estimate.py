"""Where an estimate's time goes, and how it grows with pixels, directions, faces and photographs.

    python -m tools.measure_estimate PHOTOS

Writes ``benchmarks/results/estimate-time.json`` and ``docs/images/estimate_growth.png``. Stages
are of the first photograph of the folder, in a process that has made two estimates before: seconds
on all cores. ``cold_seconds`` are whole processes of ``skylight estimate``, report included. Growth
is in processor seconds on one thread. Medians of 3. Nothing else should run on the machine.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import torch
from matplotlib import pyplot as plt

from skylight.estimate._photos import estimate_photo
from skylight.estimate._report import write_results
from skylight.evaluation._known_faces import observe_largest
from skylight.faces._model import HeadModel
from skylight.faces._observe import observe_face
from skylight.imaging._photo import read_photo
from skylight.inverse._estimate import estimate_light
from skylight.io._atomic import atomic_path
from tools.measured import write_measured

REPEATS = 3
HEIGHTS = (48, 72, 96, 144)  # pixels of the face's skin
ROWS = (32, 64, 128)  # of directions
COUNTS = (1, 2, 4)  # faces of one light, photographs


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("photos", type=Path)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/estimate-time.json"))
    parser.add_argument("--picture", type=Path, default=Path("docs/images/estimate_growth.png"))
    arguments = parser.parse_args()
    begun, photos = time.time(), sorted(arguments.photos.glob("*.jpg"))[: max(COUNTS)]
    threads = torch.get_num_threads()
    with tempfile.TemporaryDirectory() as temporary:
        stages = _stages(photos[0], Path(temporary))
        cold = [_cold(photos[0], Path(temporary) / str(k)) for k in range(REPEATS)]
    torch.set_num_threads(1)
    growth = {
        "pixels": _of_pixels(photos[0]),
        "directions": _of_directions(photos[0]),
        "faces of one light": _of_faces(photos[0]),
        "photographs": _of_photos(photos),
    }
    _draw(arguments.picture, growth)
    write_measured(
        arguments.out,
        name="estimate-time",
        what="Stages of a warm estimate and its files, whole processes, and growth.",
        command=f"python -m tools.measure_estimate {arguments.photos.name}",
        begun=begun,
        facts={
            "threads": threads,
            "warm_seconds": sum(stages.values()),
            "stages_seconds": stages,
            "cold_seconds": statistics.median(cold),
            # kilobytes on Linux
            "largest_process_mb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024,
            "growth_cpu_seconds": {
                name: {str(x): seconds for x, seconds in curve.items()}
                for name, curve in growth.items()
            },
        },
    )


def _median(action: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Of several runs after a first one."""
    action()
    seconds = []
    for _ in range(REPEATS):
        start = clock()
        action()
        seconds.append(clock() - start)
    return statistics.median(seconds)


def _stages(photo: Path, folder: Path) -> dict[str, float]:
    for _ in range(2):
        result = estimate_photo(photo)
        write_results(folder, result)
    every = [estimate_photo(photo).seconds for _ in range(REPEATS)]
    stages = {name: statistics.median(each[name] for each in every) for name in every[0]}
    stages["report and files"] = _median(lambda: write_results(folder, result), time.perf_counter)
    return stages


def _cold(photo: Path, out: Path) -> float:
    start = time.perf_counter()
    command = [sys.executable, "-m", "skylight", "estimate", str(photo), "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - start


def _of_pixels(path: Path) -> dict[int, float]:
    photo = read_photo(path)
    fit, _ = observe_largest(photo, path.name)
    curve = {}
    for height in HEIGHTS:

        def estimate(height: int = height) -> int:
            view = observe_face(
                photo.pixels, photo.clipped, HeadModel.load(), fit, face_height_px=height
            )
            estimate_light(view.observation, device="cpu")
            return len(view.places)

        curve[estimate()] = _median(estimate)
    return curve


def _of_directions(path: Path) -> dict[int, float]:
    photo = read_photo(path)
    fit, _ = observe_largest(photo, path.name)
    return {
        2 * rows**2: _median(
            lambda rows=rows: observe_face(
                photo.pixels, photo.clipped, HeadModel.load(), fit, grid_height=rows
            )
        )
        for rows in ROWS
    }


def _of_faces(path: Path) -> dict[int, float]:
    observation = observe_largest(read_photo(path), path.name)[1].observation
    return {n: _median(lambda n=n: estimate_light([observation] * n)) for n in COUNTS}


def _of_photos(paths: Sequence[Path]) -> dict[int, float]:
    return {
        n: _median(lambda n=n: [estimate_photo(path, workers=1) for path in paths[:n]])
        for n in COUNTS
    }


def _draw(path: Path, growth: dict[str, dict[int, float]]) -> None:
    figure, axes = plt.subplots(1, len(growth), figsize=(13, 3.4), layout="constrained")
    for axis, (name, curve) in zip(axes, growth.items(), strict=True):
        numbers, seconds = list(curve), list(curve.values())
        axis.plot(numbers, seconds, "o-", color="#b5522b")
        linear = [seconds[0] * n / numbers[0] for n in numbers]
        axis.plot(numbers, linear, "--", color="#9aa1a9", label="linear from the first")
        axis.set(xlabel=name, xlim=(0, None), ylim=(0, 1.3 * max(seconds)))
    axes[0].set_ylabel("processor seconds")
    axes[0].legend(frameon=False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
    plt.close(figure)


if __name__ == "__main__":
    main()
