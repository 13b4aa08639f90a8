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
``spherical``        ``ani`` of 40 bands at 32 x 64 x 32 rotations, banded=True
``spherical dense``  the same at every pixel, 64 x 128 x 32 rotations, as the planar codes have
``spherical fine``   the default, which has sharper filters too

The planar dictionary has ``ani``'s filters as they look on the equator at four twists
(:mod:`tools.planar_coder`), for sporco every fifth of them: all take a minute for ten iterations.

``smooth`` is the map without its sharpest detail (harmonics up to degree 60 under a Hann window),
``turned`` the same turned by 45 degrees about a horizontal axis, which is exact for such maps, and
``change`` the mean over maps of how far the two errors are apart. Errors are kept in ``--errors``,
so that a stopped run goes on.
"""

import argparse
import math
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import fmean

import numpy as np
import torch
from torch import Tensor

from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank, builtin
from skylight.csc._positions import Positions
from skylight.csc._sub_dictionaries import SubDictionary
from skylight.errors import InputError
from skylight.evaluation._sparse_coding import COUNTS, relative_error
from skylight.io._files import read_categories, read_environment_map
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.sphere._rotation import rotate
from tools.measured import kept, write_measured
from tools.planar_coder import Map, PlanarDictionary, pursued, refitted, solid_angles, strongest

HEIGHT = 64
ACTIVATIONS: list[int] = list(COUNTS)
TURNED, COMPARED, DEGREE = math.radians(45), 64, 60
METHODS = (
    "planar", "planar weighted", "planar pursuit", "spherical", "spherical dense", "spherical fine",
)  # fmt: skip
MAPS = {"indoor": 4, "outdoor": 2}
TWISTS, EVERY = 4, 5
PENALTIES = (0.3, 0.07)  # of the largest correlation; the second goes on from the first
ITERATIONS = 40  # of each
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
            truth = read_environment_map(arguments.data / name).resize(HEIGHT).radiance.double()
            found = {}
            for part, measured in {"as_is": as_is, "turned": turned}.items():
                path = arguments.errors / part / f"{Path(name).stem}.json"
                found |= kept(path, partial(measured, truth, coders))
            errors.setdefault(kind, {})[name] = found
            print(f"{name} {time.process_time():.0f} s", flush=True)
    write_measured(
        arguments.out,
        name="planar-codes",
        what="relative error |x - y| / |x| by K activations on 64 x 128, mean over maps, and the "
        "mean change of the error with a turn of the smooth map by 45 degrees",
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
    """Method -> K -> mean over maps; by 64 also of smooth and turned ones, and their change."""
    found = {}
    for method in METHODS:
        found[method] = {
            str(k): fmean(m[method][i] for m in maps) for i, k in enumerate(ACTIVATIONS)
        }
        pairs = [(m[f"{method} smooth"][0], m[f"{method} turned"][0]) for m in maps]
        found[method] |= {
            f"{COMPARED} smooth": fmean(before for before, _ in pairs),
            f"{COMPARED} turned": fmean(after for _, after in pairs),
            f"{COMPARED} change": fmean(abs(after - before) for before, after in pairs),
        }
    return found


def as_is(truth: Map, coders: dict[str, Coder]) -> Errors:
    """Of all numbers of activations."""
    return {method: errors_of(truth, code, ACTIVATIONS) for method, code in coders.items()}


def turned(truth: Map, coders: dict[str, Coder]) -> Errors:
    """Of 64 activations, of the smooth map before and after the turn."""
    transform = LatLongTransform(DEGREE, HEIGHT)
    factors = harmonics.window(DEGREE, "hann")[harmonics.bands(DEGREE)]
    given = transform.analyse(truth.movedim(-1, 0)) * factors
    # the polar axis of the coefficients is the zenith, their x is level
    cosine, sine = math.cos(TURNED), math.sin(TURNED)
    about_x = torch.tensor([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]], dtype=torch.float64)
    found = {}
    for name, coefficients in {"smooth": given, "turned": rotate(given, about_x)}.items():
        smooth = transform.synthesise(coefficients).movedim(0, -1)
        for method, code in coders.items():
            found[f"{method} {name}"] = errors_of(smooth, code, [COMPARED])
    return found


def errors_of(truth: Map, code: Coder, counts: list[int]) -> list[float]:
    scale = solid_angles(HEIGHT)[:, :1, None]
    return [relative_error(fit, truth, scale) for fit in code(truth, counts)]


def all_coders() -> dict[str, Coder]:
    every, few = every_filter(), few_filters()
    weight, equal = solid_angles(HEIGHT), torch.ones(HEIGHT, 2 * HEIGHT, dtype=torch.float64)

    def spherical(banded: bool, rows: int = 32) -> Coder:
        coder = SphericalSparseCoder("ani", height=HEIGHT, banded=banded)
        if banded:
            positions = Positions(rows=rows)
            part = SubDictionary(builtin("ani"), positions, dtype=torch.float32)
            coder.sub_dictionaries = torch.nn.ModuleList([part])
        return lambda truth, counts: [
            coder.decode(code).detach() for code in coder.path(truth, counts)
        ]

    coders = (
        lambda truth, counts: thresholded(truth, few, counts, equal),
        lambda truth, counts: thresholded(truth, few, counts, weight),
        lambda truth, counts: pursued(truth, every, counts, weight),
        spherical(banded=True),
        spherical(banded=True, rows=HEIGHT),
        spherical(banded=False),
    )
    return dict(zip(METHODS, coders, strict=True))


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
