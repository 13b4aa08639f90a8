"""Reconstruction error over the number of activations (thesis, Figs. 6.4a, 6.8 and 6.9).

Maps of 128 x 256. ``l2`` is ``|x - y| / |x|`` with ``|x|^2 = sum_w dw |x(w)|^2`` over the three
colours: the thesis' error of maps scaled to unit length. ``ssim`` is that of the maps as shown
(:func:`skylight.imaging.metrics.ssim`). Methods have equal *activations*, coefficients or lobes, as
in the thesis; the floats that each takes in full, indices included, are given too.

Indoor maps give the main rows, as the thesis' maps are indoor; outdoor ones have rows with
``_outdoor`` appended. k-means filters come from the other half of the collection (every second map
in the order of names), so that no map is coded with filters learned from it.
"""

import math
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc.coder import SphericalSparseCoder
from skylight.csc.learning.patches import learn_patches
from skylight.csc.pursuit.greedy import PursuitOptions, Sign
from skylight.errors import InputError
from skylight.evaluation.codes.free_gaussians import fit_gaussians, lobes_of
from skylight.evaluation.harness.pictures import captioned_rows
from skylight.evaluation.harness.run import Check, Item
from skylight.imaging.colour import tone_map
from skylight.imaging.metrics import ssim
from skylight.io.collection import read_categories
from skylight.io.files import read_environment_map, write_png
from skylight.sphere import harmonics
from skylight.sphere.envmap import luminance
from skylight.sphere.latlong_transform import LatLongTransform
from skylight.sphere.wavelets import approximate, cube_from_latlong, latlong_from_cube

COUNTS = (4, 16, 36, 64, 100, 144)
CUBE = 64  # texels along an edge: 24,576 in all, about the pixels of 128 x 256
CODE_FLOATS = 4  # three colours, and 32 bits for place, twist and filter
FLOATS = {"sh": 3, "sh_windowed": 3, "haar": 4, "sg": 6}  # of the others
SHOWN = 64
Map = Float[Tensor, "h w 3"]
CODERS = ("iso", "ani", "kmeans", "vmf")
OUTDOOR_CODERS = ("iso", "ani")  # with weights of either sign only, and no free lobes


@dataclass(frozen=True, kw_only=True)
class SparseCoding:
    """``data`` holds maps and an index.csv with the columns file and category.

    The first ``indoor`` of every third indoor map are measured, and the first ``outdoor`` of every
    twenty-first other one: one takes five to ten minutes of a core at 128 rows. ``kmeans`` has
    ``learned`` filters from at most ``learned_from`` maps.
    """

    data: Path
    height: int = 128
    counts: tuple[int, ...] = COUNTS
    indoor: int = 6
    outdoor: int = 2
    learned: int = 100
    learned_from: int = 100
    name: str = "sparse-coding"
    seed: int = 0

    def __post_init__(self) -> None:
        if not self._named("indoor"):
            raise InputError(f"{self.data / 'index.csv'}: no map of the category indoor in it")

    def config(self) -> dict[str, object]:
        return {
            "folder": self.data.name,
            "height": self.height,
            "counts": list(self.counts),
            "learned": self.learned,
            "learned_from": self.learned_from,
        }

    def items(self) -> list[str]:
        return (
            self._named("indoor")[::3][: self.indoor] + self._named("outdoor")[::21][: self.outdoor]
        )

    def _named(self, category: str) -> list[str]:
        return [name for name, kind in _index(self.data).items() if kind.startswith(category)]

    def measure(self, item: str, picture: Path) -> Item:
        truth = _read(self.data / item, self.height)
        indoor = item in self._named("indoor")
        scale = LatLongTransform(0, self.height).solid_angles[..., None]
        metrics: dict[str, dict[str, float]] = {}
        shown = {"truth": truth}

        def score(method: str, fits: list[Map]) -> None:
            name = method if indoor else f"{method}_outdoor"
            metrics[name] = {"floats_per_activation": float(FLOATS.get(method, CODE_FLOATS))}
            for count, fit in zip(self.counts, fits, strict=True):
                metrics[name][f"l2_{count}"] = relative_error(fit, truth, scale)
                metrics[name][f"ssim_{count}"] = ssim(fit, truth)
            if SHOWN in self.counts:
                shown[method] = fits[self.counts.index(SHOWN)]

        score("sh", self._harmonics(truth, windowed=False))
        score("sh_windowed", self._harmonics(truth, windowed=True))
        cube = cube_from_latlong(truth, CUBE)
        wavelets = approximate(cube, list(self.counts), "weighted")
        score("haar", [latlong_from_cube(w, self.height) for w in wavelets])
        for dictionary in CODERS if indoor else OUTDOOR_CODERS:
            coder = self._coder(dictionary, item)
            for suffix, weights in SIGNS.items():
                if not indoor and weights != "l1":
                    continue
                coder.options = PursuitOptions(weights=weights)
                codes = coder.path(truth, list(self.counts))
                score(f"{dictionary}_{suffix}", [coder.decode(code).detach() for code in codes])
                if indoor and (dictionary, suffix) == ("iso", "l1"):
                    starts = [lobes_of(code, coder) for code in codes]
                    score("sg", [fit_gaussians(truth, start) for start in starts])
        for dictionary in ("iso", "ani"):  # what the thesis' band limit costs
            coder = _banded_coder(dictionary, self.height)
            codes = coder.path(truth, list(self.counts))
            score(f"{dictionary}_k40_l1", [coder.decode(code).detach() for code in codes])
        band = "band_limit" if indoor else "band_limit_outdoor"
        metrics[band] = {
            f"l2_degree{k}": relative_error(_projected(truth, k), truth, scale)
            for k in (40, 60, min(80, self.height - 1), self.height - 1)
        }
        white = 3 * float(luminance(truth).mean())
        write_png(
            picture, captioned_rows({k: tone_map(v.float(), white=white) for k, v in shown.items()})
        )
        return Item(
            name=item, metrics=metrics, facts={"category": "indoor" if indoor else "outdoor"}
        )

    def _harmonics(self, truth: Map, *, windowed: bool) -> list[Map]:
        degrees = [math.isqrt(count) - 1 for count in self.counts]
        transform = LatLongTransform(max(degrees), self.height)
        every = transform.analyse(truth.movedim(-1, 0))
        fits = []
        for degree in degrees:
            kept = torch.zeros_like(every)
            size = (degree + 1) ** 2
            kept[:, :size] = every[:, :size]
            if windowed:
                factors = harmonics.window(degree, "hann")[harmonics.bands(degree)]
                kept[:, :size] *= factors
            fits.append(transform.synthesise(kept).movedim(0, -1))
        return fits

    def _coder(self, dictionary: str, item: str) -> SphericalSparseCoder:
        if dictionary != "kmeans":
            return _builtin_coder(dictionary, self.height)
        half = list(_index(self.data)).index(item) % 2
        sizes = self.learned, self.learned_from
        return _learned_coder(self.data, 1 - half, self.height, sizes, self.seed)

    def checks(
        self, rows: dict[str, dict[str, dict[str, float]]], items: list[Item]
    ) -> dict[str, Check]:
        """The thesis' orderings, and how much better than SH."""

        def mean(method: str, metric: str) -> float:
            return rows[method][metric]["mean"]

        checks = {}
        for count in (c for c in (64, 100) if c in self.counts):
            order = ["ani_l1", "iso_l1", "haar", "sh"]
            for better, worse in pairwise(order):
                checks[f"l2_{count}: {better} < {worse}"] = Check.below(
                    mean(better, f"l2_{count}"), mean(worse, f"l2_{count}"), worse
                )
            coders = [f"{d}_{s}" for d in CODERS for s in SIGNS]
            rest = max(mean(c, f"l2_{count}") for c in coders if c != "vmf_nnls")
            checks[f"l2_{count}: vmf_nnls is the worst coder"] = Check.at_least(
                mean("vmf_nnls", f"l2_{count}"), rest
            )
            share = mean("ani_l1", f"l2_{count}") / mean("sh", f"l2_{count}")
            checks[f"l2_{count}: ani_l1 / sh"] = Check.at_most(share, 0.7)
            for dictionary in CODERS:
                signed, positive = f"{dictionary}_l1", f"{dictionary}_nnls"
                checks[f"ssim_{count}: {positive} > {signed}"] = Check.at_least(
                    mean(positive, f"ssim_{count}"), mean(signed, f"ssim_{count}")
                )
                checks[f"ssim_{count}: {positive} > sh"] = Check.at_least(
                    mean(positive, f"ssim_{count}"), mean("sh", f"ssim_{count}")
                )
        first, last = self.counts[-2], self.counts[-1]
        for dictionary in CODERS:
            fall = {
                s: mean(f"{dictionary}_{s}", f"l2_{first}")
                - mean(f"{dictionary}_{s}", f"l2_{last}")
                for s in SIGNS
            }
            checks[f"fall of {dictionary}_nnls < of {dictionary}_l1, {first} to {last}"] = (
                Check.below(fall["nnls"], fall["l1"], f"{dictionary}_l1")
            )
        return checks


SIGNS: dict[str, Sign] = {"nnls": "nonnegative", "l1": "l1"}


def relative_error(fit: Map, truth: Map, solid_angles: Float[Tensor, "h 1 1"]) -> float:
    """``|fit - truth| / |truth|``, squares weighted by solid angle."""
    missed = ((fit - truth).square() * solid_angles).sum()
    return float((missed / (truth.square() * solid_angles).sum()).sqrt())


@cache
def _banded_coder(dictionary: str, height: int) -> SphericalSparseCoder:
    return SphericalSparseCoder(dictionary, height=height, banded=True)


@cache
def _builtin_coder(dictionary: str, height: int) -> SphericalSparseCoder:
    return SphericalSparseCoder(dictionary, height=height)


@cache
def _learned_coder(
    data: Path, half: int, height: int, sizes: tuple[int, int], seed: int
) -> SphericalSparseCoder:
    """With filters from every second map, those of number ``half`` (0 or 1) and so on.

    ``sizes``: how many filters, from how many maps at most.
    """
    count, most = sizes
    names = list(_index(data))[half::2][:most]
    maps = [_read(data / name, 128) for name in names]
    return SphericalSparseCoder(learn_patches(maps, count=count, seed=seed), height=height)


def _projected(truth: Map, degree: int) -> Map:
    transform = LatLongTransform(degree, truth.shape[0])
    return transform.synthesise(transform.analyse(truth.movedim(-1, 0))).movedim(0, -1)


@cache
def _index(data: Path) -> dict[str, str]:
    """File -> category, in the order of names."""
    return dict(sorted(read_categories(data).items()))


def _read(path: Path, height: int) -> Map:
    return read_environment_map(path).resize(height).radiance.double()
