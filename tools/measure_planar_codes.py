"""Sparse coding on the lat-long map against sparse coding on the sphere. Makes planar-codes.json.

    OMP_NUM_THREADS=1 PYTHONPATH=.:LIB python -m tools.measure_planar_codes --data DIR

``--data`` holds maps and an index.csv. LIB is a folder with sporco (Wohlberg 2017, BSD-3), which is
no dependency: ``pip install --target LIB --no-deps sporco future filetype``. Maps of 64 x 128 are
coded by K activations; errors are ``|x - y| / |x|``, squares weighted by solid angle, and every
planar code is refitted by least squares in that norm:

``planar``           sporco's ConvBPDNJoint: an L1 norm over places of the L2 norm over colours,
                     periodic. Its largest K - 1 activations and a constant are kept, of the
                     better of two penalties for each K and map
``planar weighted``  the same, searched in the map times sqrt(cos latitude)
``planar pursuit``   orthogonal matching pursuit in weighted squares, by all filters
``spherical``        ``ani`` of 40 bands at 32 x 64 x 16 rotations, banded=True
``spherical fine``   the default, which has sharper filters too

The planar dictionary has ``ani``'s filters as they look on the equator at four twists
(:mod:`tools.planar_coder`), for sporco every fifth of them: all take a minute for ten iterations.

Columns ``turned`` are of the same maps turned by 45 degrees about a horizontal axis, and ``change``
is the mean over maps of how far the two errors are apart. Each map's errors are kept in
``--errors``, so that a stopped run goes on.
"""

import argparse
import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from statistics import fmean

import numpy as np
import torch
from torch import Tensor

from skylight.csc.coder import SphericalSparseCoder
from skylight.csc.dictionary import FilterBank, builtin
from skylight.errors import InputError
from skylight.evaluation.codes.sparse_coding import COUNTS, relative_error
from skylight.io.bounded import json_content
from skylight.io.collection import read_categories
from skylight.io.files import read_environment_map
from skylight.io.json_files import write_json
from tools.measured import write_measured
from tools.planar_coder import Map, PlanarDictionary, pursued, refitted, solid_angles, strongest

HEIGHT = 64
ACTIVATIONS: list[int] = list(COUNTS)
TURNED, COMPARED = math.radians(45), 64
MAPS = {"indoor": 4, "outdoor": 2}
TWISTS, EVERY = 4, 5
PENALTIES = (0.3, 0.07)  # of the largest correlation; the second goes on from the first
ITERATIONS = 40  # of each: the objective is within 2 % of what 60 and other steps reach
Coder = Callable[[Map, list[int]], list[Map]]
Errors = dict[str, list[float]]  # method -> an error for each count


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="a collection with categories")
    parser.add_argument("--errors", type=Path, default=Path("runs/planar-codes"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/planar-codes.json"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", message="Module pyfftw")
    begun = time.time()
    index = read_categories(arguments.data)
    errors: dict[str, dict[str, Errors]] = {}
    coders = all_coders()
    for kind, count in MAPS.items():
        names = sorted(n for n, category in index.items() if category.startswith(kind))
        for name in names[:: len(names) // count][:count]:
            arguments.errors.mkdir(parents=True, exist_ok=True)
            kept = arguments.errors / f"{Path(name).stem}.json"
            if not kept.exists():
                write_json(kept, measured(arguments.data / name, coders))
            errors.setdefault(kind, {})[name] = json_content(kept)
            print(f"{name} {time.process_time():.0f} s", flush=True)
    write_measured(
        arguments.out,
        name="planar-codes",
        what="relative error |x - y| / |x| by K activations on 64 x 128, mean over maps, and the "
        "mean change of the error with a turn of the map by 45 degrees about a horizontal axis",
        command="OMP_NUM_THREADS=1 python -m tools.measure_planar_codes --data hdr",
        begun=begun,
        facts={
            "maps": {kind: len(of) for kind, of in errors.items()},
            "filters": {"pursuit": len(every_filter()), "sporco": len(few_filters())},
            **{
                f"{kind} {method}": means
                for kind, of in errors.items()
                for method, means in summary(list(of.values())).items()
            },
            "errors": errors,
        },
    )


def summary(maps: list[Errors]) -> dict[str, dict[str, float]]:
    """Method -> K -> mean over maps; of 64 activations also turned, and the change."""
    found = {
        method: {str(k): fmean(m[method][i] for m in maps) for i, k in enumerate(ACTIVATIONS)}
        for method in maps[0]
        if not method.endswith(" turned")
    }
    at = ACTIVATIONS.index(COMPARED)
    for method in found:
        pairs = [(m[method][at], m[f"{method} turned"][at]) for m in maps]
        found[method][f"{COMPARED} turned"] = fmean(after for _, after in pairs)
        found[method][f"{COMPARED} change"] = fmean(abs(after - before) for before, after in pairs)
    return found


def measured(path: Path, coders: dict[str, Coder]) -> Errors:
    """One map's errors, as it is and turned."""
    cosine, sine = math.cos(TURNED), math.sin(TURNED)
    about_x = torch.tensor([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]], dtype=torch.float64)
    given = read_environment_map(path)
    scale = solid_angles(HEIGHT)[:, :1, None]
    errors = {}
    upto = ACTIVATIONS[: ACTIVATIONS.index(COMPARED) + 1]
    for suffix, environment, counts in (
        ("", given, ACTIVATIONS),
        (" turned", given.rotate(about_x), upto),
    ):
        truth = environment.resize(HEIGHT).radiance.double()
        for method, code in coders.items():
            fits = code(truth, counts)
            errors[method + suffix] = [relative_error(fit, truth, scale) for fit in fits]
    return errors


def all_coders() -> dict[str, Coder]:
    every, few = every_filter(), few_filters()
    weight, equal = solid_angles(HEIGHT), torch.ones(HEIGHT, 2 * HEIGHT, dtype=torch.float64)

    def spherical(banded: bool) -> Coder:
        coder = SphericalSparseCoder("ani", height=HEIGHT, banded=banded)
        return lambda truth, counts: [
            coder.decode(code).detach() for code in coder.path(truth, counts)
        ]

    return {
        "planar": lambda truth, counts: thresholded(truth, few, counts, equal),
        "planar weighted": lambda truth, counts: thresholded(truth, few, counts, weight),
        "planar pursuit": lambda truth, counts: pursued(truth, every, counts, weight),
        "spherical": spherical(banded=True),
        "spherical fine": spherical(banded=False),
    }


def every_filter() -> PlanarDictionary:
    return PlanarDictionary(builtin("ani"), HEIGHT, twists=TWISTS)


def few_filters() -> PlanarDictionary:
    rows = builtin("ani").coefficients.detach()
    return PlanarDictionary(FilterBank(rows[::EVERY], "every fifth"), HEIGHT, twists=TWISTS)


def thresholded(
    truth: Map, dictionary: PlanarDictionary, counts: list[int], weight: Tensor
) -> list[Map]:
    """The fits of sporco's largest activations, for each count the better penalty's."""
    try:
        from sporco.admm.cbpdn import ConvBPDNJoint  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError(
            "planar codes need sporco: pip install --target LIB --no-deps sporco future filetype, "
            "and LIB in PYTHONPATH"
        ) from error
    scale = solid_angles(HEIGHT)[:, :1, None]
    mean = (truth * scale).sum((0, 1)) / (2 * HEIGHT * scale.sum())
    signal = (truth - mean) * weight[..., None].sqrt()
    signal = (signal / signal.norm()).float()
    correlation = [dictionary.correlation(signal[..., c]).square() for c in range(3)]
    largest = float(sum(correlation, torch.zeros(())).max().sqrt())
    options: dict[str, object] = {
        "Verbose": False, "MaxMainIter": ITERATIONS, "RelStopTol": 1e-3, "rho": 100.0,
        "AutoRho": {"Enabled": True},
    }  # fmt: skip
    filters = dictionary.filters.permute(1, 2, 0).numpy()
    best: list[Map] = []
    for penalty in PENALTIES:
        made = ConvBPDNJoint.Options(options)
        solver = ConvBPDNJoint(filters, signal.numpy(), 0.0, penalty * largest, made, dimK=0)
        solver.solve()
        options |= {"Y0": solver.Y, "U0": solver.U, "rho": solver.rho}
        sizes = torch.from_numpy(np.linalg.norm(solver.Y[:, :, :, 0], axis=2))
        atoms = strongest(sizes, counts, HEIGHT)
        fits = [refitted(truth, dictionary, some) for some in atoms]
        pairs = zip(best or fits, fits, strict=True)
        best = [min(pair, key=lambda fit: relative_error(fit, truth, scale)) for pair in pairs]
    return best


if __name__ == "__main__":
    main()
