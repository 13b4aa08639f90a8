"""Variance of importance sampling by sparse codes, against tables. Makes code-sampling.json.

    OMP_NUM_THREADS=1 python -m tools.measure_code_sampling --data ../shared/data/hdr

Integrands are those of the map itself, piecewise constant at its own resolution: its luminance
times the clamped cosine about six normals (the axes), or times a glossy lobe about the same six
directions (von Mises-Fisher of kappa = 20, 13 degrees). Codes are of ``ani`` at 128 rows with
non-negative weights. Variances of one sample, ``int g^2 / pdf - (int g)^2``, are quadratures over
the map's pixels, so rare bright samples count in full; ``z`` compares 65,536 samples of either
sampler with them. Methods:

``table``       rows and columns of the map (:class:`tools.table_sampler.TableSampler`)
``small``       the same of the map, its rows halved until it takes no more than the code's sampler
``code``        :class:`skylight.csc._sampling.CodeSampler`
``towards``     its shares weighted by the cosine to the normal (diffuse only)
``brdf``        the clamped cosine, or the glossy lobe
``X+brdf``      half of the samples from each, by the balance heuristic of one sample

Ratios are to the variance of ``table``, those of ``X+brdf`` to ``table+brdf``.

The least share of uniform samples was chosen over every second map of the collection by name (the
rows ``uniform``); all else is measured on the others. Codes are kept in ``--codes``, so that a
stopped run goes on.
"""

import argparse
import math
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import torch
from jaxtyping import Float
from matplotlib import pyplot as plt
from torch import Tensor

from skylight.csc._code import SparseCode
from skylight.csc._coder import SphericalSparseCoder, pixel_of
from skylight.csc._greedy import PursuitOptions
from skylight.csc._sampling import UNIFORM, CodeSampler
from skylight.imaging._colour import tone_map
from skylight.io._atomic import atomic_path
from skylight.io._files import read_categories, read_environment_map
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import pixel_from_direction
from tools.measured import write_measured
from tools.table_sampler import TableSampler

HEIGHT, COUNTS = 128, [16, 40, 64]
LOBE_NUMBERS = 13  # of a code's sampler: three axes, two precisions, an integral, a share
GLOSS = 20.0  # kappa
SHARES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
AXES = torch.cat([torch.eye(3), -torch.eye(3)])
SAMPLES = 2**16
SHOWN = ("leadenhall_market.exr", "kloofendal_48d_partly_cloudy_puresky.exr")
Sampler = TableSampler | CodeSampler
Density = Float[Tensor, " n"]
Ratios = dict[tuple[str, str, int], list[float]]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="a collection with categories")
    parser.add_argument("--codes", type=Path, default=Path("runs/code-sampling"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/code-sampling.json"))
    parser.add_argument("--picture", type=Path, default=Path("docs/images/code_sampling.png"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    begun = time.time()
    index = read_categories(arguments.data)
    kinds = {n: index[n].split("-")[0] for n in sorted(index)}
    names = [n for n, kind in kinds.items() if kind in ("indoor", "outdoor")]
    options = PursuitOptions(weights="nonnegative")
    coder = SphericalSparseCoder("ani", height=HEIGHT, options=options)
    sweep: list[dict[float, float]] = []
    ratios: dict[str, Ratios] = {kind: defaultdict(list) for kind in ("indoor", "outdoor")}
    scores: dict[str, list[float]] = defaultdict(list)
    sizes: dict[int, CodeSampler] = {}  # activations -> the largest sampler of any map
    for number, name in enumerate(names):
        environment = read_environment_map(arguments.data / name)
        codes = coded(coder, environment, arguments.codes / Path(name).stem)
        if number % 2:
            sweep.append(uniform_shares(coder, environment, codes[-1]))
        else:
            samplers = {
                n: CodeSampler.of(code, coder) for n, code in zip(COUNTS, codes, strict=True)
            }
            for key, values in variance_ratios(environment, samplers).items():
                ratios[kinds[name]][key] += values
            for method, z in agreement(environment, samplers[COUNTS[-1]], number).items():
                scores[method].append(z)
            for n, sampler in samplers.items():
                sizes[n] = max(sizes.get(n, sampler), sampler, key=numbers)
        print(f"{number + 1}/{len(names)} {name} {time.process_time():.0f} s", flush=True)
    samplers = {f"code {n}": largest for n, largest in sizes.items()}
    write_measured(
        arguments.out,
        name="code-sampling",
        what="variance of one sample over that of the map's table, and of X+brdf over that of "
        "table+brdf (below 1 is better): medians over maps and six directions, by kind of map, "
        "integrand, method and activations; bytes; microseconds of one thread a direction",
        command="OMP_NUM_THREADS=1 python -m tools.measure_code_sampling --data hdr",
        begun=begun,
        facts={
            "maps": {
                k: len(r["diffuse", "code", COUNTS[0]]) // len(AXES) for k, r in ratios.items()
            },
            "glossy_kappa": GLOSS,
            "uniform": {
                "chosen": UNIFORM,
                "maps": len(sweep),
                "median_ratio": {
                    str(share): statistics.median(each[share] for each in sweep) for share in SHARES
                },
            },
            **summary("indoor", ratios["indoor"]),
            **summary("outdoor", ratios["outdoor"]),
            "z_rms": {k: math.sqrt(statistics.mean(z * z for z in v)) for k, v in scores.items()},
            "bytes": {
                "table": 4 * TableSampler.of(environment).numbers,
                **{n: 4 * numbers(sampler) for n, sampler in samplers.items()},
            },
            "microseconds": {
                "table": seconds(TableSampler.of(environment)),
                **{n: seconds(sampler) for n, sampler in samplers.items()},
            },
        },
    )
    shown = [n for n in SHOWN if n in names] or names[:2]
    draw(coder, arguments, shown)


def coded(
    coder: SphericalSparseCoder, environment: EnvironmentMap, folder: Path
) -> list[SparseCode]:
    """Codes of 16, 40 and 64 activations, from the folder where they are there already."""
    files = [folder / f"{count}.json" for count in COUNTS]
    if all(file.exists() for file in files):
        return [SparseCode.load(file) for file in files]
    codes = coder.path(environment.resize(HEIGHT).radiance, COUNTS)
    folder.mkdir(parents=True, exist_ok=True)
    for code, file in zip(codes, files, strict=True):
        code.save(file)
    return codes


def integrands(
    environment: EnvironmentMap,
) -> Iterator[tuple[str, Float[Tensor, "3"], Density, Density]]:
    """Kind, axis, the integrand and the density of its BRDF's own sampler, on the map's pixels."""
    light = luminance(environment.flat.double())
    peak = GLOSS / (2 * math.pi * -math.expm1(-2 * GLOSS))
    for axis in AXES.double():
        cosine = environment.grid.directions @ axis
        clamped = cosine.clamp(min=0)
        yield "diffuse", axis, light * clamped, clamped / math.pi
        lobe = peak * torch.exp(GLOSS * (cosine - 1))
        yield "glossy", axis, light * lobe, lobe


def variance(environment: EnvironmentMap, integrand: Density, density: Density) -> float:
    """Of ``integrand / density`` for a direction of this density; its samples' part of 0 is 0."""
    weights = environment.grid.solid_angles
    lit = integrand > 0
    second = (integrand[lit].square() / density[lit] * weights[lit]).sum()
    return float(second - (integrand @ weights).square())


def on_map(environment: EnvironmentMap, sampler: Sampler) -> Density:
    """The sampler's density on the map's pixels, which sums to 1."""
    density = sampler.pdf(environment.grid.directions.float()).double()
    return density / (density @ environment.grid.solid_angles)


def variance_ratios(environment: EnvironmentMap, samplers: Mapping[int, CodeSampler]) -> Ratios:
    """(Integrand, method, activations) -> variance over the table's, for each axis."""
    table = on_map(environment, TableSampler.of(environment))
    found = defaultdict(list)
    for count, sampler in samplers.items():
        plain = {"code": on_map(environment, sampler)}
        plain["small"] = on_map(environment, small_table(environment, LOBE_NUMBERS * (count + 1)))
        for kind, axis, integrand, brdf in integrands(environment):
            single = {"table": table, **plain}
            if kind == "diffuse":
                single["towards"] = on_map(environment, sampler.towards(axis))
            alone = {n: variance(environment, integrand, d) for n, d in single.items()}
            both = {n: variance(environment, integrand, (d + brdf) / 2) for n, d in single.items()}
            alone |= {"brdf": variance(environment, integrand, brdf), "table+brdf": both["table"]}
            ratios = {n: value / alone["table"] for n, value in alone.items()}
            ratios |= {f"{n}+brdf": both[n] / both["table"] for n in both if n != "table"}
            for name, ratio in ratios.items():
                if name != "table":
                    found[kind, name, count].append(ratio)
    return found


def small_table(environment: EnvironmentMap, most: int) -> TableSampler:
    """Of the map's rows halved until h + 2 h^2 are at most ``most`` numbers.

    Whole pixels of the map lie in one of the table, as quadratures over them need.
    """
    height = environment.layout[0]
    while height + 2 * height**2 > most:
        height //= 2
    return TableSampler.of(environment.resize(height))


def numbers(sampler: CodeSampler) -> int:
    """What sampling and densities need: axes, precisions and the integral of each lobe, shares."""
    lobes = sampler.lobes
    stored = (lobes.axes, lobes.precisions, lobes.normaliser, sampler.shares, sampler.boxes)
    return sum(tensor.numel() for tensor in stored)


def uniform_shares(
    coder: SphericalSparseCoder, environment: EnvironmentMap, code: SparseCode
) -> dict[float, float]:
    """Least share of uniform samples -> geometric mean over the normals of code over table."""
    table = on_map(environment, TableSampler.of(environment))
    found = {}
    for share in SHARES:
        density = on_map(environment, CodeSampler.of(code, coder, uniform=share))
        found[share] = statistics.geometric_mean(
            variance(environment, integrand, density) / variance(environment, integrand, table)
            for kind, _, integrand, _ in integrands(environment)
            if kind == "diffuse"
        )
    return found


def agreement(environment: EnvironmentMap, code: CodeSampler, seed: int) -> dict[str, float]:
    """How many standard errors the irradiance from above is off by 65,536 samples of each."""
    _, axis, integrand, _ = next(integrands(environment))
    exact = float(integrand @ environment.grid.solid_angles)
    light = luminance(environment.flat.double())
    found = {}
    samplers: dict[str, Sampler] = {"table": TableSampler.of(environment), "code": code}
    for name, sampler in samplers.items():
        directions = sampler.sample(SAMPLES, torch.Generator().manual_seed(seed))
        here = light[pixel_of(directions.double(), environment.layout)]
        values = here * (directions.double() @ axis).clamp(min=0) / sampler.pdf(directions)
        error = math.sqrt(variance(environment, integrand, on_map(environment, sampler)) / SAMPLES)
        found[name] = (float(values.mean()) - exact) / error
    return found


def summary(group: str, ratios: Ratios) -> dict[str, dict[str, dict[str, object]]]:
    """``median_GROUP_INTEGRAND`` and ``range_...``: method -> activations -> values."""
    found: dict = {}
    for (kind, method, count), values in ratios.items():
        if method in ("brdf", "table+brdf") and count != COUNTS[0]:
            continue  # no code, so the same again
        key = "any" if method in ("brdf", "table+brdf") else str(count)
        for statistic, value in (
            ("median", statistics.median(values)),
            ("range", [min(values), max(values)]),
        ):
            rows = found.setdefault(f"{statistic}_{group}_{kind}", {})
            rows.setdefault(method, {})[key] = value
    return found


def seconds(sampler: Sampler) -> dict[str, float]:
    """Microseconds of processor time per direction: medians of 7 runs after a warm-up."""
    directions = sampler.sample(SAMPLES, torch.Generator().manual_seed(0))
    return {
        "sample": timed(lambda: sampler.sample(SAMPLES, torch.Generator().manual_seed(0))),
        "pdf": timed(lambda: sampler.pdf(directions)),
    }


def timed(work: Callable[[], object]) -> float:
    work()
    taken = []
    for _ in range(7):
        begin = time.thread_time()
        work()
        taken.append(time.thread_time() - begin)
    return statistics.median(taken) / SAMPLES * 1e6


def draw(coder: SphericalSparseCoder, arguments: argparse.Namespace, names: list[str]) -> None:
    """The same number of samples of each sampler over two maps."""
    figure, axes = plt.subplots(2, len(names), figsize=(12, 6.4), layout="constrained")
    for column, name in zip(axes.T, names, strict=True):
        environment = read_environment_map(arguments.data / name)
        code = coded(coder, environment, arguments.codes / Path(name).stem)[-1]
        small = environment.resize(HEIGHT)
        titles = {
            f"{Path(name).stem}: table of {environment.layout[0]} x {environment.layout[1]}": (
                TableSampler.of(environment)
            ),
            f"code of {len(code)} activations": CodeSampler.of(code, coder),
        }
        for ax, (title, sampler) in zip(column, titles.items(), strict=True):
            directions = sampler.sample(600, torch.Generator().manual_seed(0))
            row, across = pixel_from_direction(directions, *small.layout)
            ax.imshow(tone_map(small.radiance), interpolation="nearest")
            ax.scatter(across, row, s=5, c="#ff3b30", edgecolors="white", linewidths=0.3)
            ax.set(title=title, xlim=(-0.5, small.layout[1] - 0.5), ylim=(HEIGHT - 0.5, -0.5))
            ax.set_xticks([])
            ax.set_yticks([])
    arguments.picture.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(arguments.picture) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
    plt.close(figure)


if __name__ == "__main__":
    main()
