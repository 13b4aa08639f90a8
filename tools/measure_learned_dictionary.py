"""Learned against hand-made dictionaries on unseen indoor maps. Makes csc-learned-dictionary.json.

    OMP_NUM_THREADS=1 python tools/measure_learned_dictionary.py --data hdr \\
        --out benchmarks/results/csc-learned-dictionary.json

``--data`` holds maps and an index.csv (columns file and category). Every second map by name is the
half that is learned from; coded are the rooms of the other half, at 32 x 64 and degree 40, by three
dictionaries of which each has the filters of the one before, or as many: ``ani``; ``kmeans``, which
adds means of bright patches of the learning half; ``gradient``, which starts from these means and
fits them to codes of that half (only its rooms, which are few, with ``--fit-to indoor``).
"""

import argparse
import json
import platform
import shlex
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank, builtin
from skylight.csc._learning import ROWS, CapFilterBank, learn_patches
from skylight.io._bounded import write_json
from skylight.io._files import read_categories, read_environment_map
from skylight.training._dictionary import RATE, learning_epoch, mean_squared_error

HEIGHT = 32
COUNTS = [16, 36, 64]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--filters", type=int, default=32)
    parser.add_argument("--activations", type=int, default=36)
    parser.add_argument("--epochs", type=int, default=1)
    parser.add_argument("--fit-to", default="", help="only maps whose category begins so")
    parser.add_argument("--signed", action="store_true", help="filters may be negative")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    index = read_categories(arguments.data)
    names = sorted(index)
    halves = names[::2], names[1::2]
    fitted = [n for n in halves[0] if index[n].startswith(arguments.fit_to)]
    held_out = [n for n in halves[1] if index[n] == "indoor"]

    begun = time.process_time()
    kmeans = learn_patches(
        (read_environment_map(arguments.data / n).resize(ROWS).radiance for n in halves[0]),
        count=arguments.filters,
        seed=arguments.seed,
    )
    print(f"k-means of {len(halves[0])} maps: {time.process_time() - begun:.0f} s", flush=True)
    maps = torch.stack([read(arguments.data / n) for n in fitted])
    learned = CapFilterBank(kmeans, range(1, arguments.filters + 1), signed=arguments.signed)
    coder = SphericalSparseCoder(learned, height=HEIGHT, activations=arguments.activations)
    optimiser = torch.optim.Adam(learned.parameters(), lr=RATE)
    codes, epochs = None, []
    for _ in range(arguments.epochs):
        codes = learning_epoch(coder, optimiser, maps, codes)
        active = codes.filters[codes.used]
        mine = active[(active >= 1) & (active <= arguments.filters)]
        error = mean_squared_error(coder, maps, codes)
        use = {"filters_used": len(mine.unique()), "share": len(mine) / len(active)}
        epochs.append({"mean_squared": error, **use})
        print(f"{json.dumps(epochs[-1])} {time.process_time() - begun:.0f} s", flush=True)
    banks = {
        "ani": builtin("ani"),
        "kmeans": kmeans,
        "gradient": FilterBank(learned.coefficients, "learned"),
    }
    facts = {
        "name": "csc-learned-dictionary",
        "what": "relative error |x - y| / |x| of held-out rooms at 32 x 64, degree 40",
        "command": "python " + " ".join(shlex.quote(a) for a in without_folders(sys.argv)),
        "commit": commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{platform.machine()}, torch {torch.__version__}, 1 thread",
        "seed": arguments.seed,
        "filters": {name: len(bank) for name, bank in banks.items()},
        "patches_from": halves[0],
        "fitted_to": fitted,
        "epochs": epochs,
        "undershoot": float(learned.undershoot()[1 : arguments.filters + 1].max()),
        "learning_cpu_s": time.process_time() - begun,
    }
    coders = {n: SphericalSparseCoder(bank, height=HEIGHT) for n, bank in banks.items()}
    errors: dict[str, dict[str, dict[str, float]]] = {}
    for room in held_out:
        errors[room] = measured(coders, read(arguments.data / room))
        print(f"{room} {errors[room]} {time.process_time() - begun:.0f} s", flush=True)
        # after every room: what is stopped early leaves whole comparisons
        facts["cpu_s"] = time.process_time() - begun
        write_json(arguments.out, {**facts, **summary(errors), "relative_error": errors})


def measured(
    coders: dict[str, SphericalSparseCoder], radiance: Float[Tensor, "h w 3"]
) -> dict[str, dict[str, float]]:
    """Dictionary -> activations -> relative error."""
    return {
        name: {
            str(n): code.relative_error
            for n, code in zip(COUNTS, coder.path(radiance, COUNTS), strict=True)
        }
        for name, coder in coders.items()
    }


def summary(errors: dict[str, dict[str, dict[str, float]]]) -> dict[str, object]:
    """Means over rooms, and in how many rooms gradient's error is the smaller one."""
    names, counts = list(next(iter(errors.values()))), [str(n) for n in COUNTS]
    mean = {
        name: {c: sum(e[name][c] for e in errors.values()) / len(errors) for c in counts}
        for name in names
    }
    better = {
        name: {c: sum(e["gradient"][c] < e[name][c] for e in errors.values()) for c in counts}
        for name in names
        if name != "gradient"
    }
    return {"held_out": len(errors), "mean": mean, "rooms_where_gradient_is_better": better}


def read(path: Path) -> Float[Tensor, "h w 3"]:
    return read_environment_map(path).resize(HEIGHT).radiance


def without_folders(arguments: list[str]) -> list[str]:
    """Paths by their last part: where things lie on this machine is nobody's concern."""
    return [f"tools/{Path(arguments[0]).name}"] + [
        Path(a).name if Path(a).is_absolute() else a for a in arguments[1:]
    ]


def commit() -> str:
    done = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"


if __name__ == "__main__":
    main()
