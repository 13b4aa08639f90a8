"""Random plausible heads, drawn with MakeHuman's macro and detail targets."""

import numpy as np

from tools.head.assets import ADULT_SCALE, DECIMETRE, Assets
from tools.head.cage import Cage

RACES = ("african", "asian", "caucasian")
GENDERS = ("female", "male")
# One slider each: positive values apply the second target, negative values the first.
OPPOSITES = (
    ("-decr", "-incr"),
    ("-down", "-up"),
    ("-in", "-out"),
    ("-backward", "-forward"),
    ("-compress", "-uncompress"),
    ("-concave", "-convex"),
)
FOLDERS = ("head", "forehead", "eyebrows", "neck", "eyes", "nose", "mouth", "ears", "chin", "cheek")
# Slider standard deviations; the ends of MakeHuman's sliders (1) are caricatures.
SLIDER_STD = 0.2
SLIDER_STD_BY_PREFIX = (
    ("head-trans", 0.0),  # moves the head on the body: removed by the alignment anyway
    ("head-angle", 0.0),
    ("neck-trans", 0.0),
    ("nose-trans-in", 0.05),  # sideways, not a symmetric "inwards"
    ("mouth-trans-in", 0.05),
    ("head", 0.15),
    ("forehead", 0.15),
    ("neck", 0.15),
    ("nose-trans", 0.15),
    ("mouth-trans", 0.15),
)
ASYMMETRY_STD = 0.04  # left-right difference of paired sliders
ASYM_STD = 0.12  # the one-sided targets of targets/asym


def macro_weights(rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Convex weights of the macro targets for ``count`` people, {target: (count,)}.

    As in MakeHuman each target is weighted by the product of its factors: gender x age x race, and
    gender x age x muscle x weight, the factors of a kind summing to one.
    """
    maleness = rng.beta(0.35, 0.35, count)
    gender = {"female": 1 - maleness, "male": maleness}
    old = rng.beta(1.0, 1.8, count)  # 0: 25 years, 1: 90 years
    child = np.where(rng.random(count) < 0.03, rng.uniform(0.2, 0.8, count), 0.0)
    age = {"child": child, "young": (1 - child) * (1 - old), "old": (1 - child) * old}
    race = dict(zip(RACES, rng.dirichlet([0.6] * 3, count).T, strict=True))

    def three(spread: float) -> dict[str, np.ndarray]:
        value = np.clip(rng.normal(0, spread, count), -1, 1)
        return {
            "min": np.maximum(-value, 0),
            "average": 1 - np.abs(value),
            "max": np.maximum(value, 0),
        }

    muscle, weight = three(0.4), three(0.45)
    out = {}
    for g, gw in gender.items():
        for a, aw in age.items():
            for r, rw in race.items():
                out[f"targets/macrodetails/{r}-{g}-{a}"] = gw * aw * rw
            for m, mw in muscle.items():
                for w, ww in weight.items():
                    name = f"targets/macrodetails/universal-{g}-{a}-{m}muscle-{w}weight"
                    out[name] = gw * aw * mw * ww
    return out


def slider_std(name: str) -> float:
    for prefix, std in SLIDER_STD_BY_PREFIX:
        if name.startswith(prefix):
            return std
    return SLIDER_STD


def detail_weights(assets: Assets, rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Weights in [0, 1] of the detail targets for ``count`` people, {target: (count,)}."""
    out: dict[str, np.ndarray] = {}

    def slide(low: str | None, high: str, value: np.ndarray) -> None:
        out[high] = np.clip(value, 0, 1)
        if low is not None:
            out[low] = np.clip(-value, 0, 1)

    for folder in FOLDERS:
        stem = f"targets/{folder}/"
        names = [n[len(stem) :] for n in assets.names(folder)]
        for name in names:
            if name.startswith("r-"):
                continue  # with its left twin
            low = high = None
            for minus, plus in OPPOSITES:
                if name.endswith(plus) and name[: -len(plus)] + minus in names:
                    low, high = name[: -len(plus)] + minus, name
                elif name.endswith(minus) and name[: -len(minus)] + plus in names:
                    low, high = name, None
            if low is not None and high is None:
                continue  # drawn with its opposite
            paired = name.startswith("l-")
            std = slider_std(name[2:] if paired else (low or name))
            value = rng.normal(0, std, count)
            if high is None:  # no opposite: a shape that is present or not
                value = np.abs(value)
                high = name
            if paired:
                half = rng.normal(0, ASYMMETRY_STD, count)
                left_low = None if low is None else stem + low
                right_low = None if low is None else stem + "r-" + low[2:]
                slide(left_low, stem + high, value + half)
                slide(right_low, stem + "r-" + high[2:], value - half)
            else:
                slide(None if low is None else stem + low, stem + high, value)
    for name in assets.names("asym"):
        if "asymm-" not in name:  # those are of the body
            out[name] = np.clip(np.abs(rng.normal(0, ASYM_STD, count)), 0, 1)
    return out


def sample_heads(assets: Assets, cage: Cage, rng: np.random.Generator, count: int) -> np.ndarray:
    """Random plausible neutral heads on the cage (count, c, 3), metres, unaligned."""
    weights = macro_weights(rng, count) | detail_weights(assets, rng, count)
    names = sorted(weights)
    table = np.stack([assets.offsets(n)[cage.keep].ravel() for n in names]).astype(np.float32)
    mixed = np.stack([weights[n] for n in names], axis=1).astype(np.float32) @ table
    heads = assets.vertices[cage.keep].ravel() + mixed
    return heads.reshape(count, len(cage.keep), 3) * (DECIMETRE * ADULT_SCALE)
