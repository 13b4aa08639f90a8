"""Reconstruction error over the number of activations (thesis, Figs. 6.4a, 6.8 and 6.9).

Maps of 128 x 256. ``l2`` is ``|x - y| / |x|`` with ``|x|^2 = sum_w dw |x(w)|^2`` over the three
colours: the thesis' error of maps scaled to unit length. ``ssim`` is that of the maps as shown
(:func:`skylight.imaging._metrics.ssim`), with the truth's 98 % quantile as white; at ``SHOWN``
activations also with its mean luminance (``ssim_mean``), and with the luminance 1 of a map of unit
length (``ssim_unit``), which is what the thesis' text says if it is taken literally. Methods have
equal *activations*, coefficients or lobes, as in the thesis; the floats that each takes in full,
indices included, are given too.

Every dictionary codes with weights that are ``nnls`` or ``l1``, and as the thesis' coder of 40
bands (``_k40``) beside the default one with sharper filters; ``box`` has the latter alone. Sums of
spherical Gaussians (``sg``) have axes, sharpnesses and colours that are optimised jointly. Indoor
maps give the main rows, as the thesis' maps are indoor; others have rows with ``_outdoor``
appended. k-means filters come from the other half of the collection (every second map in the order
of names), so that no map is coded with filters learned from it.
"""

import math
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from skylight.csc._code import SparseCode
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank
from skylight.csc._greedy import PursuitOptions, Sign
from skylight.csc._learning import learn_patches
from skylight.csc._sub_dictionaries import SubDictionary, part_of
from skylight.errors import InputError
from skylight.evaluation._pictures import captioned_rows, save_figure
from skylight.evaluation._run import PROBES, Check, Item, ProbeEvaluation, Rows
from skylight.evaluation._tables import curves_of
from skylight.imaging._colour import tone_map
from skylight.imaging._metrics import ssim
from skylight.io._files import read_categories, read_environment_map, write_png
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, squared_chords
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.sphere._wavelets import approximate, cube_from_latlong, latlong_from_cube

_COLOURS = {"iso": "C0", "ani": "C1", "kmeans": "C2", "vmf": "C3", "box": "C4"}
_OTHERS = {"sh": "0.1", "sh_windowed": "0.45", "haar": "0.7", "sg": "C5"}
_PANELS = (("l2", "_k40"), ("l2", ""), ("ssim", "_k40"), ("ssim", ""))
_LABELS = {"l2": "relative L2 error", "ssim": "SSIM"}


def write_sparse_curves(path: Path, rows: Rows) -> None:
    """Coders of 40 bands on the left, with sharper filters on the right; NNLS dashed."""
    curves = curves_of(rows)
    figure = Figure(figsize=(11, 8.5), layout="constrained")
    for axes, (metric, bands) in zip(figure.subplots(2, 2).flat, _PANELS, strict=True):
        for method, curve in curves[metric].items():
            dictionary, _, sign = method.replace("_k40", "").rpartition("_")
            coder = dictionary in _COLOURS and sign in ("nnls", "l1")
            if coder and method == f"{dictionary}{bands}_{sign}":
                style = {"color": _COLOURS[dictionary], "ls": "--" if sign == "nnls" else "-"}
            elif method in _OTHERS:
                style = {"color": _OTHERS[method], "ls": "-."}
            else:
                continue
            axes.plot(*zip(*curve, strict=True), marker="o", ms=3, label=method, **style)
        axes.set_xscale("log")
        axes.set(xlabel="activations, coefficients or lobes", ylabel=_LABELS[metric])
        axes.set_title("40 bands" if bands else "with sharper filters", fontsize=10)
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=7, ncols=2)
    save_figure(path, figure, dpi=80)


STEPS = 80
RATE = 0.03
SHARPEST = 4096.0


@dataclass(frozen=True, kw_only=True)
class Lobes:
    """``sum_k rgb_k exp(kappa_k (<d_k, w> - 1))``; a kappa near 0 is a constant."""

    directions: Float[Tensor, "s 3"]
    sharpness: Float[Tensor, " s"]
    colours: Float[Tensor, "s 3"]


def lobes_of(code: SparseCode, coder: SphericalSparseCoder) -> Lobes:
    """The spherical Gaussians nearest to a code of isotropic filters: same centres, same spread.

    A lobe's mean cosine ``m = d_1 / (sqrt 3 d_0)`` gives its sharpness, about
    ``m (3 - m^2) / (1 - m^2)`` (Banerjee et al. 2005, Eq. 4.4).
    """
    parts = [each for each in coder.parts if isinstance(each, SubDictionary)]
    sharpness = []
    for filter_ in code.filters.tolist():
        part = parts[part_of(parts, filter_)]
        if filter_ - part.first >= part.count:  # a pixel
            sharpness.append(SHARPEST)
            continue
        bands = part.bank.coefficients[filter_ - part.first].detach()
        mean = float((bands[2] / (3**0.5 * bands[0])).clamp(0.0, 0.9998))
        sharpness.append(min(SHARPEST, max(1e-2, mean * (3 - mean**2) / (1 - mean**2))))
    return Lobes(
        directions=code.directions,
        sharpness=torch.tensor(sharpness, dtype=torch.float64),
        colours=code.weights,
    )


def fit_gaussians(truth: Float[Tensor, "h w 3"], start: Lobes) -> Float[Tensor, "h w 3"]:
    """The map of the best lobes that descent from ``start`` finds, by the L2 error.

    Directions and log sharpnesses go by Adam; the colours, which may be negative, are the
    least-squares solution of every step (variable projection).
    """
    height, width = truth.shape[:2]
    grid = DirectionGrid.latlong(height, width)
    directions_out = grid.directions.float()
    root = grid.solid_angles.float().sqrt()[:, None]
    target = truth.reshape(-1, 3).float() * root
    target = target / target.norm()
    directions = start.directions.float().clone().requires_grad_()
    sharpness = start.sharpness.float().log().clone().requires_grad_()

    def lobes() -> Float[Tensor, "n s"]:
        unit = torch.nn.functional.normalize(directions, dim=1)
        kappa = sharpness.clamp(max=torch.tensor(SHARPEST).log()).exp()
        return root * torch.exp(-0.5 * kappa * squared_chords(directions_out, unit))

    def solved(shape: Float[Tensor, "n s"]) -> Float[Tensor, "s 3"]:
        gram = (shape.T @ shape).double()
        ridge = 1e-7 * gram.diagonal().mean() * torch.eye(len(gram), dtype=torch.float64)
        return torch.linalg.solve(gram + ridge, (shape.T @ target).double()).float()

    best, least = None, float("inf")
    optimiser = torch.optim.Adam([directions, sharpness], lr=RATE)
    for _ in range(STEPS):
        optimiser.zero_grad()
        shape = lobes()
        # variable projection: the colours are the best ones, so their own gradient is zero
        colours = solved(shape.detach())
        fit = shape @ colours
        loss = (fit - target).square().sum()
        if loss.item() < least:
            least, best = loss.item(), fit.detach() / root
        loss.backward()
        optimiser.step()
    assert best is not None
    norm = (truth.reshape(-1, 3) * root.double()).norm()
    return (best.double() * norm).reshape(truth.shape)


COUNTS = (4, 16, 36, 64, 100, 144)
CUBE = 64  # texels along an edge: 24,576 in all, about the pixels of 128 x 256
CODE_FLOATS = 4  # three colours, and 32 bits for place, twist and filter
FLOATS = {"sh": 3, "sh_windowed": 3, "haar": 4, "sg": 6}  # of the others
SHOWN = 64
Map = Float[Tensor, "h w 3"]
CODERS = ("iso", "ani", "kmeans", "vmf")
SIGNS: dict[str, Sign] = {"nnls": "nonnegative", "l1": "l1"}
BANDS = {"vmf": (True,), "box": (False,)}  # the others: as the thesis' coder, and with sharper ones
OTHER_WHITES = ("ssim_mean", "ssim_unit")


@dataclass(frozen=True, kw_only=True)
class SparseCoding(ProbeEvaluation):
    """``data`` holds maps and an index.csv with the columns file and category.

    All maps are measured, or the first ``indoor`` and ``outdoor`` ones: one takes two to three
    minutes of a core at 128 rows. ``kmeans`` has ``learned`` filters from at most ``learned_from``
    maps. Free Gaussians (``sg``) are fitted to indoor maps alone, which they take 24 s each.
    """

    title = "sparse-coding"
    needs = PROBES
    selects = ("data", "indoor", "outdoor")
    # two maps of 64 rows and short codes
    quick = MappingProxyType(
        {"height": 64, "counts": (4, 16), "indoor": 2, "outdoor": 0, "learned": 6}
    )

    height: int = 128
    counts: tuple[int, ...] = COUNTS
    indoor: int | None = None
    outdoor: int | None = None
    learned: int = 100
    learned_from: int = 100

    def __post_init__(self) -> None:
        if not any(self._is_indoor(name) for name in _index(self.probes)):
            raise InputError(f"{self.probes / 'index.csv'}: no map of the category indoor in it")

    def items(self) -> list[str]:
        every = list(_index(self.probes))
        outdoor = [name for name in every if not self._is_indoor(name)]
        return [name for name in every if self._is_indoor(name)][: self.indoor] + outdoor[
            : self.outdoor
        ]

    def _is_indoor(self, name: str) -> bool:
        return _index(self.probes)[name].startswith("indoor")

    def measure(self, item: str, picture: Path) -> Item:
        truth = _read(self.probes / item, self.height)
        indoor = self._is_indoor(item)
        scale = LatLongTransform(0, self.height).solid_angles[..., None]
        metrics: dict[str, dict[str, float]] = {}
        shown = {"truth": truth}
        brightness = float(luminance(truth).mean())
        length = float((truth.square() * scale).sum().sqrt())
        whites = dict(zip(OTHER_WHITES, (brightness, length), strict=True))

        def score(method: str, fits: list[Map]) -> None:
            name = method if indoor else f"{method}_outdoor"
            metrics[name] = {"floats_per_activation": float(FLOATS.get(method, CODE_FLOATS))}
            for count, fit in zip(self.counts, fits, strict=True):
                metrics[name][f"l2_{count}"] = relative_error(fit, truth, scale)
                metrics[name][f"ssim_{count}"] = ssim(fit, truth)
            if SHOWN in self.counts:
                shown[method] = fits[self.counts.index(SHOWN)]
                for tones, white in whites.items():
                    metrics[name][f"{tones}_{SHOWN}"] = ssim(shown[method], truth, white=white)

        score("sh", self._harmonics(truth, windowed=False))
        score("sh_windowed", self._harmonics(truth, windowed=True))
        cube = cube_from_latlong(truth, CUBE)
        wavelets = approximate(cube, list(self.counts), "weighted")
        score("haar", [latlong_from_cube(w, self.height) for w in wavelets])
        for dictionary in (*CODERS, "box"):
            for banded in BANDS.get(dictionary, (True, False)):
                coder = self._coder(dictionary, item, banded=banded)
                for sign, weights in SIGNS.items():
                    coder.options = PursuitOptions(weights=weights)
                    codes = coder.path(truth, list(self.counts))
                    method = _row(dictionary, sign, banded=banded)
                    score(method, [coder.decode(code).detach() for code in codes])
                    if indoor and method == "iso_l1":
                        starts = [lobes_of(code, coder) for code in codes]
                        score("sg", [fit_gaussians(truth, start) for start in starts])
        band = "band_limit" if indoor else "band_limit_outdoor"
        metrics[band] = {
            f"l2_degree{k}": relative_error(_projected(truth, k), truth, scale)
            for k in (40, 60, min(80, self.height - 1), self.height - 1)
        }
        pictures = {k: tone_map(v.float(), white=3 * brightness) for k, v in shown.items()}
        write_png(picture, captioned_rows(pictures))
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

    def _coder(self, dictionary: str, item: str, *, banded: bool) -> SphericalSparseCoder:
        if dictionary != "kmeans":
            return _builtin_coder(dictionary, self.height, banded)
        half = list(_index(self.probes)).index(item) % 2
        sizes = self.learned, self.learned_from
        return _learned_coder(self.probes, 1 - half, self.height, sizes, self.seed, banded)

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        """The thesis' orderings, of its own coder and of the default one; how much below SH."""

        def mean(method: str, metric: str) -> float:
            return rows[method][metric]["mean"]

        checks = {}
        for banded in (True, False):
            coder = {(d, s): _row(d, s, banded=banded or d == "vmf") for d in CODERS for s in SIGNS}
            for count in (c for c in (SHOWN, 100) if c in self.counts):
                l2 = f"l2_{count}"
                order = [*(coder[d, "l1"] for d in ("ani", "kmeans", "iso")), "haar", "sh"]
                for better, worse in pairwise(order):
                    checks[f"{l2}: {better} < {worse}"] = Check.below(
                        mean(better, l2), mean(worse, l2), worse
                    )
                rest = max(mean(c, l2) for key, c in coder.items() if key != ("vmf", "nnls"))
                checks[f"{l2}: {coder['vmf', 'nnls']} is the worst, {_kind(banded)}"] = (
                    Check.at_least(mean(coder["vmf", "nnls"], l2), rest)
                )
                share = mean(coder["ani", "l1"], l2) / mean("sh", l2)
                checks[f"{l2}: {coder['ani', 'l1']} / sh"] = Check.at_most(share, 0.7)
            tones = [f"ssim_{count}" for count in (SHOWN, 100) if count in self.counts]
            tones += [f"{t}_{SHOWN}" for t in OTHER_WHITES if SHOWN in self.counts]
            for metric in tones:
                for dictionary in CODERS:
                    signed, positive = coder[dictionary, "l1"], coder[dictionary, "nnls"]
                    for other in (signed, "sh"):
                        checks[f"{metric}: {positive} > {other}"] = Check.at_least(
                            mean(positive, metric), mean(other, metric)
                        )
            first, last = f"l2_{self.counts[-2]}", f"l2_{self.counts[-1]}"
            for dictionary in CODERS:
                signed, positive = coder[dictionary, "l1"], coder[dictionary, "nnls"]
                fall = {c: mean(c, first) - mean(c, last) for c in (signed, positive)}
                counts = f"{self.counts[-2]} to {self.counts[-1]}"
                checks[f"fall of {positive} < of {signed}, {counts}"] = Check.below(
                    fall[positive], fall[signed], signed
                )
        if SHOWN in self.counts:
            l2 = f"l2_{SHOWN}"
            checks[f"{l2}: box_l1 < ani_l1"] = Check.below(
                mean("box_l1", l2), mean("ani_l1", l2), "ani_l1"
            )
        return checks

    def illustrate(self, out: Path, rows: Rows, items: list[Item]) -> None:
        """``figure_6_8.png``, which has Fig. 6.9 too."""
        write_sparse_curves(out / "figure_6_8.png", rows)


def _row(dictionary: str, sign: str, *, banded: bool) -> str:
    """``ani_nnls`` of the default coder, ``ani_k40_nnls`` of the thesis'."""
    return f"{dictionary}_k40_{sign}" if banded else f"{dictionary}_{sign}"


def _kind(banded: bool) -> str:
    return "of 40 bands" if banded else "of sharper filters"


def relative_error(
    fit: Float[Tensor, "*s"], truth: Float[Tensor, "*s"], solid_angles: Float[Tensor, "..."]
) -> float:
    """``|fit - truth| / |truth|``, squares weighted by solid angle."""
    missed = ((fit - truth).square() * solid_angles).sum()
    return float((missed / (truth.square() * solid_angles).sum()).sqrt())


@cache
def _builtin_coder(dictionary: str, height: int, banded: bool) -> SphericalSparseCoder:
    return SphericalSparseCoder(dictionary, height=height, banded=banded)


@cache
def _learned_coder(
    data: Path, half: int, height: int, sizes: tuple[int, int], seed: int, banded: bool
) -> SphericalSparseCoder:
    return SphericalSparseCoder(_learned(data, half, sizes, seed), height=height, banded=banded)


@cache
def _learned(data: Path, half: int, sizes: tuple[int, int], seed: int) -> FilterBank:
    """Filters from every second map, those of number ``half`` (0 or 1) and so on.

    ``sizes``: how many filters, from how many maps at most.
    """
    count, most = sizes
    maps = [_read(data / name, 128) for name in list(_index(data))[half::2][:most]]
    return learn_patches(maps, count=count, seed=seed)


def _projected(truth: Map, degree: int) -> Map:
    transform = LatLongTransform(degree, truth.shape[0])
    return transform.synthesise(transform.analyse(truth.movedim(-1, 0))).movedim(0, -1)


@cache
def _index(data: Path) -> dict[str, str]:
    """File -> category, in the order of names."""
    return dict(sorted(read_categories(data).items()))


def _read(path: Path, height: int) -> Map:
    return read_environment_map(path).resize(height).radiance.double()
