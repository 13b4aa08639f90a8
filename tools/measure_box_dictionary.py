"""Gaussians of a limited band against boxes of pixels on real maps. Makes csc-box-dictionary.json.

    OMP_NUM_THREADS=1 python -m tools.measure_box_dictionary --data DIR \\
        --out benchmarks/results/csc-box-dictionary.json

``--data`` holds maps and an index.csv (columns file and category). The sizes of the boxes were
chosen on maps of the first, third, ... name; coded are the others, at 32 x 64 pixels, by three
dictionaries of which each has the filters of the one before: ``ani``, ``pixel``, which adds
single pixels, and ``box``. Then ``ani`` and ``box`` again with every map turned about a slanted
axis, after which lamps and walls are no longer along rows and columns; and at 64 and 128 rows,
where ``ani`` has sharper filters and pixels too, a few maps of both kinds.
"""

import argparse
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import mean, median

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._sub_dictionaries import BoxDictionary
from skylight.io._files import read_categories, read_environment_map
from skylight.sphere._rotation import matrix_from_euler
from tools.measured import write_measured

HEIGHT = 32
COUNTS = [16, 36, 64]
TURN = (0.7, 0.6, 2.1)  # Euler angles in radians: the zenith moves by 148 degrees
FINER = {64: 2, 128: 1}  # rows: rooms, and as many other maps
Errors = dict[str, list[float]]  # dictionary -> relative errors, at COUNTS


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument(
        "--out", type=Path, default=Path("benchmarks/results/csc-box-dictionary.json")
    )
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    begun = time.time()
    index = read_categories(arguments.data)
    names = sorted(index)[1::2]
    groups = {
        "rooms": [n for n in names if index[n] == "indoor"],
        "others": [n for n in names if index[n] != "indoor"],
    }
    seconds = {}

    def measured(
        coders: Mapping[str, SphericalSparseCoder], chosen: Iterable[str], *, turned: bool = False
    ) -> dict[str, Errors]:
        found: dict[str, Errors] = {name: {} for name in chosen}
        for dictionary, coder in coders.items():
            started = time.process_time()
            for name in found:
                codes = coder.path(read(arguments.data / name, coder.height, turned), COUNTS)
                found[name][dictionary] = [code.relative_error for code in codes]
                print(f"{coder.height} {name} {dictionary} {found[name][dictionary]}", flush=True)
            taken = (time.process_time() - started) / len(found)
            seconds[f"{dictionary} at {coder.height} rows"] = taken
        return found

    coders = {name: SphericalSparseCoder(name, height=HEIGHT) for name in ("ani", "box")}
    turned = measured(coders, names, turned=True)
    upright = measured({**coders, "pixel": with_pixels()}, names)
    of_groups = {g: {n: upright[n] for n in some} for g, some in groups.items()}
    finer = {
        f"{rows} rows": measured(
            {name: SphericalSparseCoder(name, height=rows) for name in ("ani", "box")},
            [name for some in groups.values() for name in some[:count]],
        )
        for rows, count in FINER.items()
    }
    write_measured(
        arguments.out,
        name="csc-box-dictionary",
        what=f"relative error |x - y| / |x| of maps of {HEIGHT} rows, degree 40",
        command=f"python -m tools.measure_box_dictionary --data {arguments.data.name} "
        f"--out benchmarks/results/{arguments.out.name}",
        begun=begun,
        facts={
            "maps": {group: len(some) for group, some in groups.items()},
            "cpu_seconds_a_map": seconds,
            "mean": summary(upright, mean),
            "rooms_mean": summary(of_groups["rooms"], mean),
            "rooms_median": summary(of_groups["rooms"], median),
            "others_mean": summary(of_groups["others"], mean),
            "others_median": summary(of_groups["others"], median),
            "turned_mean": summary(turned, mean),
            "box_is_better": {group: better(some) for group, some in of_groups.items()},
            **{f"{rows}_mean": summary(some, mean) for rows, some in finer.items()},
            "relative_error": upright,
            "relative_error_turned": turned,
            "relative_error_finer": finer,
        },
    )


def with_pixels() -> SphericalSparseCoder:
    """``ani`` and single pixels."""
    coder = SphericalSparseCoder("box", height=HEIGHT)
    boxes = coder.parts[-1]
    coder.sub_dictionaries[-1] = BoxDictionary(HEIGHT, boxes.first, coder.degree)
    return coder


def read(path: Path, height: int, turned: bool) -> Float[Tensor, "h w 3"]:
    environment = read_environment_map(path)
    if turned:
        turn = matrix_from_euler(*torch.tensor(TURN, dtype=torch.float64))
        environment = environment.resize(256).rotate(turn)
    return environment.resize(height).radiance


def summary(
    errors: Mapping[str, Errors], of: Callable[[Sequence[float]], float]
) -> dict[str, dict[str, float]]:
    """Dictionary -> activations -> mean or median over maps."""
    return {
        name: {str(n): of([one[name][i] for one in errors.values()]) for i, n in enumerate(COUNTS)}
        for name in next(iter(errors.values()))
    }


def better(errors: Mapping[str, Errors]) -> dict[str, dict[str, int]]:
    """Dictionary -> activations -> in how many maps ``box`` has the smaller error."""
    return {
        name: {
            str(n): sum(one["box"][i] < one[name][i] for one in errors.values())
            for i, n in enumerate(COUNTS)
        }
        for name in ("ani", "pixel")
    }


if __name__ == "__main__":
    main()
