"""Compression of the rows of a transport matrix (thesis, Fig. 6.7).

A row of T divided by the pixels' solid angles is a function on the sphere, ``V(w) <n, w>+ / pi``.
Errors are relative, ``|x - approximation| / |x|`` weighted by solid angle, and averaged over rows.
Each method keeps as many coefficients, or activations, as its column says: a spherical harmonic
takes one number, a wavelet or an activation a second one for which it is.

Sparse codes: dictionaries of degree :data:`BANDS` at :data:`POSITIONS`. Spherical harmonics: the
first (n + 1)^2, as they are and windowed (Hann). Haar: wavelets on a cube map, the choice that is
best in the error measured here.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.csc._compressed_transport import (
    CompressedTransport,
    row_codes,
    row_signals,
    transform_for,
)
from skylight.csc._dictionary import BuiltinName, FilterBank, anisotropic, builtin
from skylight.csc._greedy import PursuitOptions, Sign, Support
from skylight.csc._positions import Positions
from skylight.csc._sub_dictionaries import SubDictionary, rotated_atoms
from skylight.evaluation._lit_object import MESH, PIXELS, lit_object
from skylight.evaluation._pictures import Picture, caption, sized
from skylight.evaluation._run import (
    Check,
    Item,
    Metrics,
    ProbeEvaluation,
    Rows,
    mesh_files,
)
from skylight.evaluation._sparse_coding import relative_error
from skylight.imaging._colour import linear_to_srgb
from skylight.io._files import read_categories, read_environment_map, write_png
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.sphere._wavelets import (
    approximate,
    cube_from_latlong,
    haar,
    latlong_from_cube,
    texel_solid_angles,
)
from skylight.transport._matrix import TransportMatrix

COUNTS = (1, 9, 25, 49)
HEIGHT = 32
CUBE = 32  # texels along a face's edge: finer than a row's pixels, so that all of a row is kept
LIGHTS = 4  # maps that rows are relit by, from all over the index
RELIGHTING = "relighting"
Code = tuple[BuiltinName, Sign]
CODES: dict[str, Code] = {
    "iso_l1": ("iso", "l1"),
    "vmf_l1": ("vmf", "l1"),
    "ani_l1": ("ani", "l1"),
    "ani_nnls": ("ani", "nonnegative"),
}
# A thousand rows are many codes. Over four rows with 49 activations (ani, l1) the error is 0.115
# with 24 bands, 36 anisotropic filters and these positions (0.6 s of a core a row), 0.080 with 40
# bands, 100 filters and 24 x 48 x 16 positions (2.2 s).
BANDS, ANISOTROPIC = 24, 36
POSITIONS = Positions(rows=16, twists=16)


@dataclass(frozen=True, kw_only=True)
class TransportCompression(ProbeEvaluation):
    """``rows`` of T, spread evenly, in items of ``chunk``.

    Every ``nonnegative_every``-th is coded with ``ani_nnls`` too, which is slow.

    The item "relighting" times relighting, with ``timed_rows`` rows coded and repeated to as many
    as the thesis has.
    """

    title = "transport-compression"
    quick = MappingProxyType({"rows": 24, "chunk": 4, "nonnegative_every": 4, "timed_rows": 4})

    rows: int = 1000
    chunk: int = 25
    nonnegative_every: int = 10
    timed_rows: int = 60

    def __post_init__(self) -> None:
        _ = self.probes
        mesh_files(self.data, [MESH])

    def items(self) -> list[str]:
        chunks = math.ceil(self.rows / self.chunk)
        return [f"rows_{i:03d}" for i in range(chunks)] + [RELIGHTING]

    def measure(self, item: str, picture: Path) -> Item:
        transport = dragon_transport(self.data)
        if item == RELIGHTING:
            return self._timed(transport)
        start = self.chunk * self.items().index(item)
        mine = range(start, min(start + self.chunk, self.rows))
        spread = [p * len(transport.matrix) // self.rows for p in mine]
        signals = row_signals(transport)
        lit = _lights(self.probes)
        scores: dict[str, dict[str, list[float]]] = {}
        shown: dict[str, _Shown] = {}
        for number, p in zip(mine, spread, strict=True):
            signal = signals[p]
            if float(signal.abs().sum()) == 0:
                continue
            nonnegative = (number - start) % self.nonnegative_every == 0
            for method, approximations in _approximations(signal, nonnegative=nonnegative).items():
                for count, found in zip(COUNTS, approximations, strict=True):
                    into = scores.setdefault(method, {})
                    into.setdefault(f"l2_{count}", []).append(_error(found, signal))
                    into.setdefault(f"shading_{count}", []).append(_relit(found, signal, lit))
                shown.setdefault(method, _Shown(signal=signal, found=approximations))
        if shown:
            write_png(picture, _picture(shown))
        metrics: Metrics = {
            method: {metric: float(np.mean(v)) for metric, v in of.items()}
            for method, of in scores.items()
        }
        return Item(name=item, metrics=metrics, facts={"rows": spread})

    def _timed(self, transport: TransportMatrix) -> Item:
        """Sizes, seconds for one light, and errors of shading, of :data:`PIXELS` rows."""
        light = _lights(self.probes)[:, :3]
        coded = torch.linspace(0, len(transport.matrix) - 1, self.timed_rows).long()
        repeat = torch.arange(PIXELS) % len(coded)
        dense = transport.matrix[coded][repeat]
        truth = dense.double() @ light
        facts: dict[str, object] = {
            "pixels": PIXELS,
            "dense": {
                "floats": dense.numel(),
                "seconds": _best_seconds(lambda: dense @ light.float()),
            },
        }
        signals = row_signals(transport)[coded]
        for name in ("iso", "ani"):
            parts, transform = _coding(name)
            paths = [row_codes(s, parts, transform, [25, 49]) for s in signals]
            for path, count in enumerate((25, 49)):
                codes = [paths[i][path] for i in repeat.tolist()]
                compressed = CompressedTransport.of(codes, parts, transform)
                facts[f"{name}_l1_{count}"] = {
                    "floats": compressed.floats,
                    "seconds": _best_seconds(lambda c=compressed: c.relight(light)),
                    "shading_error": _relative(compressed.relight(light), truth),
                }
        for count in (25, 49):
            basis = _sh_basis(count)
            project = basis.T * transport.grid.solid_angles
            rows = (dense.double() @ basis).float()
            facts[f"sh_{count}"] = {
                "floats": rows.numel(),
                "seconds": _best_seconds(lambda r=rows, p=project: r @ (p @ light).float()),
                "shading_error": _relative(rows.double() @ (project @ light), truth),
            }
        for count in (25, 49):
            facts[f"haar_{count}"] = _haar_relighting(signals, count, repeat, light, truth)
        return Item(name=RELIGHTING, metrics={}, facts=facts)

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        """The thesis: convolutional models give better results that are more compact."""
        if "ani_l1" not in rows:
            return {}
        return {
            f"ani_l1, {count}": Check.below(
                rows["ani_l1"][f"l2_{count}"]["mean"], rows["sh"][f"l2_{count}"]["mean"], "sh"
            )
            for count in COUNTS
        }


@cache
def dragon_transport(data: Path) -> TransportMatrix:
    """T of the dragon at :data:`HEIGHT` rows; once per process."""
    return lit_object(data).transport(DirectionGrid.latlong(HEIGHT))


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """A row, and how a method has it."""

    signal: Float[Tensor, "h w"]
    found: list[Float[Tensor, "h w"]]


def _bank(name: BuiltinName) -> FilterBank:
    return anisotropic(BANDS, ANISOTROPIC) if name == "ani" else builtin(name, BANDS)


@cache
def _coding(name: BuiltinName) -> tuple[tuple[SubDictionary, ...], LatLongTransform]:
    isotropic = Positions(rows=POSITIONS.rows, twists=1)
    parts = (SubDictionary(_bank(name), POSITIONS if name == "ani" else isotropic),)
    return parts, transform_for(parts, HEIGHT)


@cache
def _lights(data: Path) -> Float[Tensor, "n c"]:
    """Some of the maps, each of mean luminance about 1, side by side: (n, 3 lights)."""
    files = list(read_categories(data))
    maps = []
    for file in files[:: max(1, len(files) // LIGHTS)][:LIGHTS]:
        light = read_environment_map(data / file).resize(HEIGHT).flat.double()
        maps.append(light / light.mean())
    return torch.cat(maps, 1)


def _approximations(
    signal: Float[Tensor, "h w"], *, nonnegative: bool
) -> dict[str, list[Float[Tensor, "h w"]]]:
    """The row as each method has it, for all of :data:`COUNTS`."""
    found = _harmonic(signal)
    cube = cube_from_latlong(signal[..., None], CUBE)
    found["haar"] = [
        latlong_from_cube(c, HEIGHT)[..., 0] for c in approximate(cube, COUNTS, "weighted")
    ]
    for method, (name, weights) in CODES.items():
        if weights == "l1" or nonnegative:
            parts, transform = _coding(name)
            options = PursuitOptions(weights=weights)
            codes = row_codes(signal, parts, transform, list(COUNTS), options)
            found[method] = [_decoded(code, parts[0], transform) for code in codes]
    return found


def _harmonic(signal: Float[Tensor, "h w"]) -> dict[str, list[Float[Tensor, "h w"]]]:
    """The first (n + 1)^2 coefficients, cut and windowed."""
    share = DirectionGrid.latlong(HEIGHT).solid_angles
    cut, windowed = [], []
    for count in COUNTS:
        basis = _sh_basis(count)
        coefficients = basis.T @ (share * signal.flatten())
        degree = harmonics.degree_of(count)
        factors = harmonics.window(degree, "hann")[harmonics.bands(degree)]
        cut.append((basis @ coefficients).view_as(signal))
        windowed.append((basis @ (factors * coefficients)).view_as(signal))
    return {"sh": cut, "sh_windowed": windowed}


@cache
def _sh_basis(count: int) -> Float[Tensor, "n k"]:
    grid = DirectionGrid.latlong(HEIGHT)
    return harmonics.evaluate_about_zenith(grid.directions, harmonics.degree_of(count))


def _decoded(
    code: Support, part: SubDictionary, transform: LatLongTransform
) -> Float[Tensor, "h w"]:
    atoms = rotated_atoms([part], code.tensors([part])).detach()
    return transform.synthesise(code.weights[:, 0] @ atoms)


def _error(found: Float[Tensor, "h w"], signal: Float[Tensor, "h w"]) -> float:
    """``|x - y| / |x|``, weighted by solid angle."""
    return relative_error(found, signal, DirectionGrid.latlong(HEIGHT).solid_angles.view_as(signal))


def _relit(
    found: Float[Tensor, "h w"], signal: Float[Tensor, "h w"], lights: Float[Tensor, "n c"]
) -> float:
    """Relative error of the row's shading, mean over colours of all lights."""
    weighted = DirectionGrid.latlong(HEIGHT).solid_angles[:, None] * lights
    true = signal.flatten() @ weighted
    return float(((found.flatten() @ weighted - true).abs() / true).mean())


def _haar_relighting(
    signals: Float[Tensor, "r h w"],
    count: int,
    repeat: Int[Tensor, " m"],
    light: Float[Tensor, "n c"],
    truth: Float[Tensor, "m c"],
) -> dict[str, object]:
    """Rows' largest wavelets times the light's, both on the cube map."""
    root = texel_solid_angles(CUBE)[..., None].sqrt()
    wavelets = torch.stack(
        [haar(root * cube_from_latlong(s[..., None], CUBE)).flatten() for s in signals]
    )
    kept = wavelets.abs().topk(count, dim=1).indices
    weights = wavelets.gather(1, kept)[repeat].float()
    kept = kept[repeat]

    def relight() -> Float[Tensor, "m c"]:
        maps = cube_from_latlong(light.reshape(HEIGHT, 2 * HEIGHT, -1), CUBE)
        coefficients = haar(root * maps).flatten(0, 2).float()
        return torch.einsum("ms,msc->mc", weights, coefficients[kept])

    return {
        "floats": 2 * weights.numel(),
        "seconds": _best_seconds(relight),
        "shading_error": _relative(relight().double(), truth),
    }


def _relative(found: Float[Tensor, "m c"], truth: Float[Tensor, "m c"]) -> float:
    return float((found - truth).norm() / truth.norm())


def _best_seconds(work: Callable[[], object]) -> float:
    """The least of several: others use the machine too."""
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def _picture(shown: dict[str, _Shown]) -> Picture:
    """One line for each method: a row, and its approximations from few to many numbers."""
    return np.vstack([_line(method, row) for method, row in shown.items()])


def _line(method: str, row: _Shown) -> Picture:
    white = float(row.signal.max())

    def tile(values: Float[Tensor, "h w"], label: str) -> Picture:
        codes = (255 * linear_to_srgb((values / white).clamp(0, 1))).round().to(torch.uint8)
        grey = codes[..., None].expand(-1, -1, 3).numpy()
        width = 4 * HEIGHT
        return np.vstack([caption(label, width), sized(grey, width, width // 2)])

    tiles = [tile(row.signal, method)]
    tiles += [
        tile(found, f"{count}: {_error(found, row.signal):.3f}")
        for count, found in zip(COUNTS, row.found, strict=True)
    ]
    return np.hstack(tiles)
