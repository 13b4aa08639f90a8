"""How far simulated training skies are from captured maps.

    python -m tools.measure_sky_realism --data ../shared/data/hdr

Bare simulated skies, and those varied as ``configs/sky_autoencoder.yaml`` says (mirrored, tinted,
surroundings before them, balanced), are compared with a collection's outdoor maps: by the
distribution of each statistic of :func:`sky_statistics`, and by how well classifiers tell simulated
skies from captured ones by all of them together. All skies are 32 x 128, of mean luminance 1.

Distances are 1-Wasserstein, in the statistic's unit; their floor is the mean between random halves
of the captured maps. It errs upwards, as halves scatter more: of 42 maps, 1.6 times as far as 42
are from 200 of the same normal distribution. Maps of one place stay in one half, and in one fold.
"""

import argparse
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.stats import wasserstein_distance
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GroupShuffleSplit, StratifiedGroupKFold, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from torch import Tensor

from skylight.evaluation._sky_models import KnownSkies
from skylight.skies._index import normalise
from skylight.skies._simulated import simulated_skies
from skylight.sphere._envmap import luminance, shift_columns
from skylight.sphere._frame import DirectionGrid
from skylight.training._config import AutoencoderConfig, find_config, read_config
from skylight.training._skies import augment
from tools.measured import write_measured

BANDS_DEG = ((0, 30), (30, 60), (60, 80), (80, 90))  # zenith angles
STATISTICS = {  # and their units; logarithms are natural
    "log_luminance": "1",
    "log_luminance_sd": "1",
    "azimuthal_gradient": "1/deg",
    "vertical_gradient": "1/deg",
    "log_red_green": "1",
    "log_blue_green": "1",
}
NAMES = [f"{name}_{low}_{high}" for low, high in BANDS_DEG for name in STATISTICS]
DARKEST = 1e-5  # smallest radiance, in units of the mean luminance: what is black has no logarithm
SCORES = ("balanced_accuracy", "roc_auc")
SPLITS, FOLDS, REPEATS = 20, 5, 5


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="a collection with categories")
    parser.add_argument("--count", type=int, default=200, help="simulated skies")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/sky-realism.json"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    begun = time.time()
    captured = KnownSkies(count=1000, seed=0, data=arguments.data)
    if not captured.collected:
        parser.error(f"{arguments.data}: its index has no categories")
    names = captured.names()
    places = [place(name) for name in names]
    real = sky_statistics(torch.stack([captured.sky(i).radiance for i in range(len(names))]))
    columns = {"captured_sd": real.std(0, ddof=1), "floor": floor(real, places)}
    classifiers = {}
    for kind, skies in training_skies(arguments.count).items():
        simulated = sky_statistics(skies)
        columns[kind] = distances(simulated, real)
        classifiers[kind] = told_apart(real, simulated, places)
    write_measured(
        arguments.out,
        name="sky-realism",
        what="1-Wasserstein distances of simulated skies' statistics, over bands of zenith angle "
        "in degrees, from captured ones' (floor: between halves of these); classifiers of the two",
        command=f"python -m tools.measure_sky_realism --data {arguments.data} "
        f"--count {arguments.count}",
        begun=begun,
        facts={
            "captured": len(names),
            "simulated": arguments.count,
            "units": STATISTICS,
            **{k: dict(zip(NAMES, v.tolist(), strict=True)) for k, v in columns.items()},
            "classifiers": classifiers,
        },
    )
    print(f"\n{'distance':<28}" + "".join(f"{name:>13}" for name in columns))
    for i in np.argsort(-columns["varied"] / columns["captured_sd"]):  # the most different first
        print(f"{NAMES[i]:<28}" + "".join(f"{values[i]:>13.4f}" for values in columns.values()))
    for kind, scores in classifiers.items():
        for name, found in scores.items():
            print(f"{kind}, {name}: " + ", ".join(f"{k} {v:.3f}" for k, v in found.items()))


def training_skies(count: int) -> dict[str, Float[Tensor, "n h w 3"]]:
    """``bare`` and ``varied`` skies of evaluation seeds, which nothing was trained on.

    Turned by a random part of a column. Captured maps are turned so that their sun is in a
    column's middle; the interpolation smooths them, and has to smooth these alike.
    """
    config = read_config(find_config("sky_autoencoder"))
    assert isinstance(config, AutoencoderConfig)
    generator = torch.Generator().manual_seed(0)
    simulated = simulated_skies(count, first_seed=0)
    bare = normalise(torch.stack([sky.radiance for _, sky in simulated]))
    varied = augment(bare, generator, config)
    turn = torch.rand(count, generator=generator) * 2 * math.pi / bare.shape[2]
    return {"bare": shift_columns(bare, turn), "varied": shift_columns(varied, turn)}


def sky_statistics(skies: Float[Tensor, "n h w 3"]) -> Float[ndarray, "n k"]:
    """The k statistics :data:`NAMES` of each sky.

    Over each band: mean and standard deviation of ln Y (luminance Y), the means of
    |d ln Y / (sin z da)| and |d ln Y / dz| (differences of neighbouring pixels over their angle;
    azimuth a, zenith angle z), and the means of ln(R/G) and ln(B/G), all weighted by solid angle.
    """
    height, width = skies.shape[1:3]
    rgb = skies.double().clamp(min=DARKEST)
    y, colour = luminance(rgb).log(), rgb.log()
    solid = DirectionGrid.sky(height).solid_angles.reshape(height, width)[:, 0]
    step = 90 / height
    centre = (torch.arange(height, dtype=torch.float64) + 0.5) * step
    between = torch.arange(1, height, dtype=torch.float64) * step  # rows' borders
    aside = (y - y.roll(1, 2)).abs().mean(2) / (360 / width * torch.deg2rad(centre).sin())
    down = y.diff(dim=1).abs().mean(2) / step
    columns = []
    for low, high in BANDS_DEG:
        of_rows = _weights(centre, solid, low, high)
        of_borders = _weights(between, torch.deg2rad(between).sin(), low, high)
        mean = y.mean(2) @ of_rows
        variance = (y - mean[:, None, None]).square().mean(2) @ of_rows
        red, blue = ((colour[..., c] - colour[..., 1]).mean(2) @ of_rows for c in (0, 2))
        columns += [mean, variance.sqrt(), aside @ of_rows, down @ of_borders, red, blue]
    return torch.stack(columns, dim=1).numpy()


def _weights(
    zenith_deg: Float[Tensor, " r"], weight: Float[Tensor, " r"], low: int, high: int
) -> Float[Tensor, " r"]:
    """``weight`` within the band, of sum 1."""
    inside = weight * ((zenith_deg >= low) & (zenith_deg < high))
    return inside / inside.sum()


def place(name: str) -> str:
    """Where a map was taken: the first word of its name, but for who handed it on."""
    return name.removeprefix("pmndrs_").split("_")[0]


def distances(a: Float[ndarray, "n k"], b: Float[ndarray, "m k"]) -> Float[ndarray, " k"]:
    """1-Wasserstein distance of each statistic's distributions."""
    return np.array([wasserstein_distance(x, y) for x, y in zip(a.T, b.T, strict=True)])


def floor(real: Float[ndarray, "n k"], places: Sequence[str]) -> Float[ndarray, " k"]:
    """Mean distance between halves, over random halvings of the places."""
    split = GroupShuffleSplit(SPLITS, test_size=0.5, random_state=0).split(real, groups=places)
    return np.mean([distances(real[one], real[other]) for one, other in split], axis=0)


def told_apart(
    real: Float[ndarray, "n k"], simulated: Float[ndarray, "m k"], places: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Balanced accuracy and area under the ROC curve on held-out skies; 0.5 is chance.

    Means over the folds of stratified cross-validations, each simulated sky a place of its own.
    """
    skies = np.concatenate([real, simulated])
    is_real = np.repeat([1, 0], [len(real), len(simulated)])
    groups = [*places, *(f"simulated {i}" for i in range(len(simulated)))]
    classifiers = {
        "logistic": make_pipeline(
            StandardScaler(), LogisticRegression(class_weight="balanced", max_iter=1000)
        ),
        "forest": RandomForestClassifier(
            100, min_samples_leaf=5, class_weight="balanced", random_state=0
        ),
    }
    cuts = [StratifiedGroupKFold(FOLDS, shuffle=True, random_state=i) for i in range(REPEATS)]
    given = {"X": skies, "y": is_real, "groups": groups, "scoring": SCORES}
    runs = {
        name: [cross_validate(classifier, cv=cut, **given) for cut in cuts]
        for name, classifier in classifiers.items()
    }
    return {
        name: {score: float(np.mean([run[f"test_{score}"] for run in found])) for score in SCORES}
        for name, found in runs.items()
    }


if __name__ == "__main__":
    main()
